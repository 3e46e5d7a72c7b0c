"""`exceptiondrive tokens`: a team looks after its own tokens."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from tests.client.servers import run, submit
from typer.testing import CliRunner

from exceptiondrive import Client
from exceptiondrive.cli import app
from exceptiondrive.organizer import Organizer

if TYPE_CHECKING:
    from tests.client.servers import Running

MakeFile = Callable[..., Path]


@pytest.fixture
def keeper(running: "Running") -> str:
    """A token of team Alpha that may manage the team's tokens."""
    with Organizer(running.url, running.organizer_token) as organizer:
        return str(organizer.issue_token("alpha", "keeper")["token"])


def tokens(server: "Running", token: str, *words: str) -> Any:
    environment = {"EXCEPTIONDRIVE_SERVER": server.url, "EXCEPTIONDRIVE_TOKEN": token}
    return CliRunner().invoke(app, ["tokens", *words], env=environment)


def test_a_token_is_created_rotated_and_revoked(running: "Running", keeper: str) -> None:
    made = tokens(running, keeper, "create", "CI", "--scope", "submit")
    assert made.exit_code == 0, made.output
    first = made.stdout.strip()
    with Client(running.url, first) as client:
        assert client.me().scopes == ("submit",)
    rotated = tokens(running, keeper, "rotate", first.split("_")[2], "--keep-days", "0")
    second = rotated.stdout.strip()
    assert "ends now" in rotated.stderr
    assert tokens(running, first, "list").exit_code == 4
    assert tokens(running, keeper, "revoke", second.split("_")[2]).exit_code == 0
    listed = json.loads(tokens(running, keeper, "list", "--json").stdout)
    assert {token["name"] for token in listed} >= {"keeper", "CI"}
    assert first not in json.dumps(listed)
    assert tokens(running, keeper, "revoke", second.split("_")[2]).exit_code == 4


def test_a_scope_that_there_is_not_is_told_which_there_are(running: "Running", keeper: str) -> None:
    refused = tokens(running, keeper, "create", "x", "--scope", "admin")
    said = "--scope is submit, read:own or tokens, not 'admin'."
    assert (refused.exit_code, said in refused.stderr) == (2, True)


def test_a_revoked_token_leaves_behind_what_it_made(running: "Running", keeper: str) -> None:
    lost = tokens(running, keeper, "create", "lost", "--scope", "tokens").stdout.strip()
    door = tokens(running, lost, "create", "door", "--scope", "tokens").stdout.strip()
    door_id = door.split("_")[2]
    revoked = tokens(running, keeper, "revoke", lost.split("_")[2])
    assert revoked.exit_code == 0, revoked.output
    assert "revoke these too, unless they are to stay" in revoked.stdout
    assert f"{door_id}  door  (edk_s_{door_id}, made by lost (" in revoked.stdout
    environment = {
        "EXCEPTIONDRIVE_SERVER": running.url,
        "EXCEPTIONDRIVE_TOKEN": running.organizer_token,
    }
    words = ["organizer", "teams", "revoke-token", keeper.split("_")[2]]
    assert f"{door_id}  door" in CliRunner().invoke(app, words, env=environment).stdout


def test_a_token_without_the_scope_is_told_which_it_needs(running: "Running") -> None:
    done = tokens(running, running.token, "list")
    assert done.exit_code == 4
    assert "tokens" in done.stderr


def test_the_page_of_a_submission_is_its_stable_address(running: "Running") -> None:
    with Client(running.url, running.token) as client:
        assert client.page_url("abc") == f"{running.url}/submissions/abc"


@pytest.fixture
def sender(working: "Running") -> str:
    """A token of team Alpha that may submit and withdraw, and read nothing."""
    with Organizer(working.url, working.organizer_token) as organizer:
        keeper = str(organizer.issue_token("alpha", "keeper")["token"])
    return str(tokens(working, keeper, "create", "ci", "--scope", "submit").stdout.strip())


def test_a_token_that_reads_nothing_submits_what_it_may_replace_and_waits_for_nothing(
    working: "Running", sender: str, planning_file: MakeFile
) -> None:
    path = planning_file()
    unknown = (
        "hich entry of your team it replaces cannot be told without a token with the scope read:own"
    )
    named = ("--phase", "dev", "--method", "Planner")
    checked = run(working, "check", path, *named, token=sender)
    assert (checked.exit_code, unknown in checked.stdout) == (0, True)
    assert "replaces no other entry" not in checked.stdout
    assert run(working, "check", path, *named, token=" ").stdout == checked.stdout, (
        "nor without any"
    )

    def sent(*more: str) -> Any:
        return run(working, "submit", path, *named, *more, token=sender)

    waiting = sent("--wait", "--replace")
    assert (waiting.exit_code, "lacks the scope read:own. Nothing was sent" in waiting.stderr) == (
        4,
        True,
    )
    unasked = sent()
    assert (unasked.exit_code, "add --replace" in unasked.stderr) == (2, True)
    assert json.loads(run(working, "submissions", "--json").stdout) == []
    done = sent("--replace")
    assert done.exit_code == 0, done.stderr
    assert submit(working, path, "--wait").exit_code == 0
    again = sent("--replace").stdout
    assert (
        "score and rank not told in phase dev: they are to a token with the scope read:own" in again
    )
    (one,) = json.loads(run(working, "submissions", "--json").stdout)
    gone = run(working, "withdraw", one["id"], token=sender)
    assert gone.exit_code == 0, gone.stderr
    assert gone.stdout.startswith(f"{one['id']} withdrawn: without the scope read:own")
