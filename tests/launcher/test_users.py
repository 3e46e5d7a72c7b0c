"""A user of its own for the server, or all of it root's: never something in between."""

import os
import sys
from pathlib import Path

import pytest
from tests.chaos.users import can_change_user

from exceptiondrive_server.launcher.users import SERVER_USER, own_user_of_server

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
