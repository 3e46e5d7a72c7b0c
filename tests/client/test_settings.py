"""The usual server and phase, and which of several places comes first."""

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from exceptiondrive.cli import app
from exceptiondrive.credentials import find_token, keep_token, server_setting
from exceptiondrive.errors import InvalidArgumentError
from exceptiondrive.settings import (
    Setting,
    config_path,
    default_phase,
    find_setting,
    keep_setting,
)

BOARD = "https://board.example.org"


def run(*arguments: str) -> Any:
    return CliRunner().invoke(app, arguments)


def test_an_option_comes_before_the_environment_before_the_file(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert find_setting("phase") == Setting(None, "")
    keep_setting("phase", "of-file")
    assert find_setting("phase") == Setting("of-file", str(config_path()))
    monkeypatch.setenv("EXCEPTIONDRIVE_PHASE", " of-environment ")
    assert find_setting("phase") == Setting("of-environment", "EXCEPTIONDRIVE_PHASE")
    assert find_setting("phase", "of-option") == Setting("of-option", "--phase")
    assert default_phase() == "of-environment"


def test_a_user_without_a_home_has_no_settings_and_keeps_none(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As in a container under a user id that its list of users does not have."""
    pwd = pytest.importorskip("pwd", reason="where users have numbers")
    for variable in ("HOME", "XDG_CONFIG_HOME"):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setattr(pwd, "getpwuid", {}.__getitem__)
    assert find_setting("phase") == Setting(None, "")
    assert find_token(BOARD) is None
    assert run("config").exit_code == 0
    kept = run("config", "phase", "dev")
    assert kept.exit_code == 2
    assert "cannot be written" in kept.output


def test_the_file_comes_before_the_last_login() -> None:
    assert server_setting() == Setting("http://127.0.0.1:8000", "default")
    keep_token("http://logged.in:1", "t")
    assert server_setting() == Setting("http://logged.in:1", "login")
    keep_setting("server", BOARD)
    assert server_setting() == Setting(BOARD, str(config_path()))


def test_without_a_phase_anywhere_it_is_said_what_to_do() -> None:
    with pytest.raises(InvalidArgumentError, match="No phase was named") as caught:
        default_phase()
    assert "exceptiondrive config phase PHASE" in caught.value.advice
    done = run("submit", "x.json", "--method", "M")
    assert (done.exit_code, "No phase was named" in done.stderr) == (2, True)


def test_the_command_writes_the_file_and_shows_what_holds(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert run("config", "server", "HTTPS://Board.example.org/").exit_code == 0
    assert run("config", "phase", 'a "quoted" one').exit_code == 0
    assert config_path() == home / "config" / "exceptiondrive" / "config.toml"
    assert config_path().read_text() == f'server = "{BOARD}"\nphase = "a \\"quoted\\" one"\n'
    monkeypatch.setenv("EXCEPTIONDRIVE_PHASE", "other")
    shown = json.loads(run("config", "--json").stdout)
    assert shown == {
        "path": str(config_path()),
        "settings": {
            "server": {"value": BOARD, "found_in": str(config_path())},
            "phase": {"value": "other", "found_in": "EXCEPTIONDRIVE_PHASE"},
        },
    }
    assert "EXCEPTIONDRIVE_PHASE says other" in run("config", "phase", "dev").stdout
    assert run("config", "phase", "--unset").exit_code == 0
    assert config_path().read_text() == f'server = "{BOARD}"\n'


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('fase = "x"', "Did you mean 'phase'?"),
        ("phase = 3", 'Write it like: phase = "dev"'),
        ("phase = dev", "cannot be read"),
    ],
)
def test_a_file_with_a_fault_is_named_and_never_passed_over(text: str, words: str) -> None:
    config_path().parent.mkdir(parents=True)
    config_path().write_text(text)
    done = run("leaderboard")
    assert done.exit_code == 2
    assert words in done.stderr
    assert str(config_path()) in done.stderr


def test_a_setting_that_there_is_not_is_said_whatever_was_asked() -> None:
    for more in ((), ("VALUE",), ("--unset",)):
        assert "There is no setting 'foo'." in run("config", "foo", *more).stderr


@pytest.mark.parametrize(
    "arguments", [("fase", "x"), ("phase",), ("phase", "x", "--unset"), ("server", "ftp://x")]
)
def test_wrong_arguments_keep_nothing(arguments: tuple[str, ...]) -> None:
    assert run("config", *arguments).exit_code == 2
    assert not config_path().exists()
