import json
import stat
import sys
from pathlib import Path

import pytest

from exceptiondrive.credentials import (
    DEFAULT_SERVER,
    credentials_path,
    find_server,
    find_token,
    forget_token,
    is_sent_in_clear,
    keep_token,
    normal_server,
)
from exceptiondrive.errors import InvalidArgumentError, NotAllowedError

BOARD = "https://board.example.org"


def test_without_any_setting_it_is_this_machine_and_no_token() -> None:
    assert find_server() == DEFAULT_SERVER
    assert find_token(DEFAULT_SERVER) is None


def test_a_kept_token_belongs_to_its_server_which_becomes_the_usual_one(home: Path) -> None:
    path = keep_token(BOARD, "edk_t_1")
    assert home in path.parents
    assert find_server() == BOARD
    assert find_token(BOARD) == "edk_t_1"
    assert find_token(DEFAULT_SERVER) is None


def test_the_argument_comes_before_the_environment_before_what_was_kept(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    keep_token(BOARD, "kept")
    monkeypatch.setenv("EXCEPTIONDRIVE_SERVER", "http://here:1/")
    monkeypatch.setenv("EXCEPTIONDRIVE_TOKEN", " set \n")
    assert find_server() == "http://here:1"
    assert find_server("http://there:2") == "http://there:2"
    assert find_token(BOARD) == "set"


@pytest.mark.skipif(sys.platform == "win32", reason="modes are a POSIX matter")
def test_the_file_is_readable_by_its_owner_alone(home: Path) -> None:
    path = keep_token(BOARD, "edk_t_1")
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
    assert [child.name for child in path.parent.iterdir()] == [path.name]


@pytest.mark.skipif(sys.platform == "win32", reason="modes are a POSIX matter")
def test_a_file_that_others_can_read_is_not_used() -> None:
    path = keep_token(BOARD, "edk_t_1")
    path.chmod(0o640)
    with pytest.raises(NotAllowedError, match="chmod 600"):
        find_token(BOARD)


def test_forgetting_leaves_the_tokens_of_other_servers() -> None:
    keep_token(BOARD, "one")
    keep_token(DEFAULT_SERVER, "two")
    assert forget_token(BOARD)
    assert not forget_token(BOARD)
    assert find_token(BOARD) is None
    assert find_token(DEFAULT_SERVER) == "two"


@pytest.mark.parametrize("content", ["rubbish", "[]", '{"tokens": 5}', "[" * 100_000], ids=range(4))
def test_a_damaged_file_is_said(content: str) -> None:
    path = credentials_path()
    path.parent.mkdir(parents=True)
    path.write_text(content)
    path.chmod(0o600)
    with pytest.raises(InvalidArgumentError, match="damaged"):
        find_token(BOARD)


def test_a_folder_of_settings_that_cannot_be_made_is_said(
    home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (home / "file").write_text("")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(home / "file"))
    assert find_token(BOARD) is None
    with pytest.raises(InvalidArgumentError, match="cannot be written: Not a directory") as caught:
        keep_token(BOARD, "edk_t_1")
    assert caught.value.advice == "Without it a token is taken from EXCEPTIONDRIVE_TOKEN."


def test_a_file_of_tokens_that_is_none_is_said() -> None:
    credentials_path().mkdir(parents=True)
    with pytest.raises(InvalidArgumentError, match="cannot be read: Is a directory"):
        find_token(BOARD)


def test_no_token_is_stored_beside_the_documented_keys() -> None:
    path = keep_token(BOARD, "edk_t_1")
    assert json.loads(path.read_text()) == {"server": BOARD, "tokens": {BOARD: "edk_t_1"}}


@pytest.mark.parametrize(
    ("given", "normal"),
    [
        ("HTTP://Board.Example.org/", "http://board.example.org"),
        ("https://example.org/bench/", "https://example.org/bench"),
    ],
)
def test_an_address_has_one_form(given: str, normal: str) -> None:
    assert normal_server(given) == normal


@pytest.mark.parametrize(
    "given",
    [
        *("board.example.org", "ftp://x", "http://", "https://u:p@x"),
        *("http://x:port", "http://x:65536", "http://x:0", "http://[::1"),
    ],
)
def test_what_is_no_address_is_refused(given: str) -> None:
    with pytest.raises(InvalidArgumentError, match="is not the address of a server"):
        normal_server(given)


@pytest.mark.parametrize(
    ("server", "in_clear"),
    [
        ("https://example.org", False),
        ("http://127.0.0.1:8000", False),
        ("http://localhost:8000", False),
        ("http://[::1]:8000", False),
        ("http://127.9.9.9", False),
        ("http://localhost.:8000", False),
        ("http://example.org", True),
        ("http://127.0.0.1.attacker.example", True),
        ("http://localhost.attacker.example", True),
        ("http://192.168.0.5", True),
    ],
)
def test_a_token_over_plain_http_to_another_machine_is_noticed(server: str, in_clear: bool) -> None:
    assert is_sent_in_clear(server) is in_clear
