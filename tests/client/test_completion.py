"""Completion as the shells ask for it: words, and never an error or a traceback."""

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import pytest
from typer.main import get_command
from typer.testing import CliRunner

from exceptiondrive.cli import app, completion

if TYPE_CHECKING:
    from tests.client.servers import Running

NOBODY = "http://127.0.0.1:9"
PATIENT = """
import sys
from exceptiondrive.__main__ import main
from exceptiondrive.cli import completion

completion.LONGEST_WAIT_S = 60.0
sys.argv[0] = "exceptiondrive"
main()
"""
"""The command; a shell at a prompt waits for a server no longer than a second, which a busy machine takes."""


def asked_by(shell: str, line: str) -> dict[str, str]:
    """The environment in which the script of a shell asks, at the end of a line."""
    words = line.split(" ")
    asked = {
        "bash": {"COMP_WORDS": line, "COMP_CWORD": str(len(words) - 1)},
        "zsh": {"_TYPER_COMPLETE_ARGS": line},
        "fish": {"_TYPER_COMPLETE_ARGS": line, "_TYPER_COMPLETE_FISH_ACTION": "get-args"},
    }[shell]
    return {"_EXCEPTIONDRIVE_COMPLETE": f"complete_{shell}", **asked}


def completed(shell: str, line: str, **environment: str) -> "subprocess.CompletedProcess[str]":
    """Ask as the script of a shell does."""
    return subprocess.run(
        [sys.executable, "-c", PATIENT],
        env={**os.environ, **asked_by(shell, line), **environment},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_every_shell_gets_the_phases(running: "Running", shell: str) -> None:
    done = completed(
        shell, "exceptiondrive leaderboard --phase w", EXCEPTIONDRIVE_SERVER=running.url
    )
    assert done.stderr == ""
    assert "words" in done.stdout
    assert "dev" not in done.stdout


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("exceptiondrive submi", {"submit", "submissions"}),
        ("exceptiondrive manifest ", {"dev", "words"}),
        ("exceptiondrive split download ", {"tiny"}),
        ("exceptiondrive submissions --status re", {"received", "rejected"}),
        ("exceptiondrive leaderboard --view ", {"main", "late"}),
        ("exceptiondrive leaderboard --sort hc", {"hcc"}),
        ("exceptiondrive config ph", {"phase"}),
        ("exceptiondrive config phase d", {"dev"}),
        ("exceptiondrive convert --from n", {"navsim"}),
        ("exceptiondrive convert --rotate ", {"90", "-90", "180"}),
        ("exceptiondrive report d", {"dev"}),
        ("exceptiondrive organizer phases freeze d", {"dev"}),
        ("exceptiondrive organizer phases create --frozen-scores ", {"shown", "hidden"}),
    ],
)
def test_commands_names_and_choices(
    running: "Running", monkeypatch: pytest.MonkeyPatch, line: str, words: set[str]
) -> None:
    monkeypatch.setattr(completion, "LONGEST_WAIT_S", 60.0)
    done = CliRunner().invoke(
        app,
        prog_name="exceptiondrive",
        env={**asked_by("bash", line), "EXCEPTIONDRIVE_SERVER": running.url},
    )
    assert (done.stderr, set(done.stdout.split())) == ("", words)


def test_ids_of_the_team_are_offered(running: "Running", planning_file: object) -> None:
    assert callable(planning_file)
    with running.client() as client:
        own = client.submit(planning_file(), phase="dev", method="Planner").id
    environment = {
        "EXCEPTIONDRIVE_SERVER": running.url,
        "EXCEPTIONDRIVE_TOKEN": running.token,
    }
    line = f"exceptiondrive status {own[:3]}"
    assert completed("bash", line, **environment).stdout.split() == [own]
    assert f'"{own}":"Planner, received"' in completed("zsh", line, **environment).stdout


def test_organizers_are_offered_teams(running: "Running") -> None:
    environment = {
        "EXCEPTIONDRIVE_SERVER": running.url,
        "EXCEPTIONDRIVE_TOKEN": running.organizer_token,
    }
    (team,) = completed(
        "bash", "exceptiondrive organizer teams show ", **environment
    ).stdout.split()
    done = completed("zsh", "exceptiondrive organizer teams merge x --into ", **environment)
    assert f'"{team}":' in done.stdout
    assert (
        completed("bash", "exceptiondrive organizer rescore begin ", **environment).stdout.strip()
        == ""
    )


def parameters(command: Any, names: tuple[str, ...] = ()) -> Iterator[tuple[str, Any]]:
    for each in command.params:
        yield " ".join(names), each
    for name in command.list_commands(None) if hasattr(command, "list_commands") else ():
        yield from parameters(command.get_command(None, name), (*names, name))


NAMES = {"PHASE", "TEAM", "RUN", "[RUN]", "STATUS", "ROLE", "PLANNER", "WHAT", "WHAT...", "S"}
NUMBERS = {"--timeout", "--time-step-s"}


def test_every_name_and_choice_is_offered() -> None:
    """What takes a phase, a team, a run or one of some words has something to offer."""
    asked = 0
    for command, each in parameters(get_command(app)):
        words = re.fullmatch(r"-?[\w-]+(\|-?[\w-]+)+", each.metavar or "")
        is_of_words = words is not None and not {"TIME", "K", "N"} & set(
            (each.metavar or "").split("|")
        )
        is_a_name = each.metavar in NAMES or "--phase" in each.opts
        if (is_of_words or is_a_name) and not NUMBERS & set(each.opts):
            asked += 1
            assert each._custom_shell_complete is not None, (command, each.opts, each.metavar)
    assert asked > 50


@pytest.mark.parametrize("server", [NOBODY, "no address", "http://127.0.0.1:9/with/path"])
def test_offline_there_is_nothing_and_no_error(server: str) -> None:
    done = completed("bash", "exceptiondrive status ", EXCEPTIONDRIVE_SERVER=server)
    assert (done.stdout.strip(), done.stderr) == ("", "")
