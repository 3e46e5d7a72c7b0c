"""A user of its own for the server, or all of it root's: never something in between."""

import os
import sys
from pathlib import Path

import pytest
from tests.chaos.users import can_change_user

from exceptiondrive_server.launcher.users import SERVER_USER, own_user_of_server

OTHER_USER = 10002
PROTECTED_REGULAR = Path("/proc/sys/fs/protected_regular")


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """A data folder that a server of its own user has written in before."""
    if not can_change_user():
        pytest.skip("only root may give files to other users")
    folder = tmp_path / "data"
    (folder / "uploads/ab").mkdir(parents=True)
    for path in (folder / "records.sqlite3", folder / "uploads/ab/file"):
        path.touch()
        os.chown(path, SERVER_USER, SERVER_USER)
    return folder


def test_where_no_other_user_reaches_python_all_files_are_roots_again(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    closed = tmp_path / "closed"
    closed.mkdir(mode=0o700)
    (closed / "python").symlink_to(sys.executable)
    monkeypatch.setattr(sys, "executable", str(closed / "python"))
    user, words = own_user_of_server(data)
    assert user is None
    assert "run as one user" in words
    assert data.stat().st_mode & 0o7777 == 0o700
    assert {path.stat().st_uid for path in (data, *data.rglob("*"))} == {0}


def test_a_system_that_keeps_root_from_files_of_others_is_named(data: Path) -> None:
    """As Debian does by itself; then the worker could not write the records."""
    keeps = PROTECTED_REGULAR.exists() and PROTECTED_REGULAR.read_text().strip() == "2"
    user, words = own_user_of_server(data)
    assert ("fs.protected_regular" in words) == keeps
    assert user is None or not keeps


@pytest.mark.parametrize("name", ["uploads", "records.sqlite3-of-mine", ".of-the-server-PID"])
@pytest.mark.parametrize("inner", ["", "split.json"])
def test_root_gives_the_server_nothing_that_its_links_lead_to(
    data: Path, tmp_path: Path, name: str, inner: str
) -> None:
    """Whoever took it over may put a link in the place of whatever it owns, and wait for a restart."""
    name = name.replace("PID", str(os.getpid()))
    withheld = tmp_path / "splits"
    withheld.mkdir()
    split = withheld / "split.json"
    split.touch()
    for path in (withheld, split):
        os.chown(path, OTHER_USER, OTHER_USER)
    (data / "uploads/ab/link").symlink_to(withheld)
    if name == "uploads":
        (data / name).rename(data / "moved")
    (data / name).symlink_to(withheld / inner)
    own_user_of_server(data)
    assert {path.stat().st_uid for path in (withheld, split)} == {OTHER_USER}
