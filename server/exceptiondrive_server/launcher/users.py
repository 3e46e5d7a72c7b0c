"""Runs the server as a user of its own, so that an attacker in the web process cannot open split files.

Only root may start processes as another user. Otherwise server and worker run as the same user, and
the launcher says what that means.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from exceptiondrive_server.launcher.child import LaunchError

SERVER_USER = 10001
"""The number that compose.yaml gives the server; it needs no account."""
_SHARED_FOLDER = 0o1770
"""The server makes files here; the sticky bit keeps it from moving those of others away."""
_PROBE = """
import os, sys
from importlib.util import find_spec
for name in ("fastapi", "exceptiondrive_records", "exceptiondrive_server.app"):
    open(find_spec(name).origin).close()
os.listdir(sys.argv[1])
"""
_ONE_USER = (
    "server and worker run as one user: whoever takes over the web process can read withheld regions. {why} "
    "For withheld splits, use compose.yaml."
)
_OWN_USER = (
    f"the server runs as user {SERVER_USER}, who cannot open split files. It writes all records, and workers "
    "believe them, even that a split is public: for withheld splits, use compose.yaml."
)


def own_user_of_server(data: Path) -> tuple[int | None, str]:
    """Prepare the data folder for a server of its own user.

    What the server writes in it becomes its own, all else stays root's.

    Returns:
        The user, or None where it cannot be had, and then all is root's; and a sentence for who started this.
    """
    if os.geteuid() != 0:
        return None, _ONE_USER.format(
            why="Started as root, this command gives the server a user of its own."
        )
    own = [*data.glob("records.sqlite3*"), *data.glob("receipt-key.pem"), data / "uploads"]
    try:
        os.chown(data, 0, SERVER_USER)
        data.chmod(_SHARED_FOLDER)
        why = _why_not(data)
        if why is not None:
            data.chmod(0o700)
        for path in own:
            _give_ownership(path, SERVER_USER if why is None else 0)
    except OSError as error:
        raise LaunchError(f"cannot share {data} with the server's user: {error.strerror}") from None
    if why is not None:
        return None, _ONE_USER.format(why=why)
    return SERVER_USER, _OWN_USER


def _why_not(data: Path) -> str | None:
    """Return why server and worker cannot be two users who share the data, if there is a reason."""
    if not _may_root_write_servers_file(data):
        return "This system keeps root from the server's files in a shared folder (fs.protected_regular)."
    unreachable = _unreachable_path(data)
    return unreachable and f"Another user cannot run it from here ({unreachable})."


def _may_root_write_servers_file(data: Path) -> bool:
    """Try it as SQLite opens a file: to be made if it is not there."""
    new, path = tempfile.mkstemp(prefix=".of-the-server-", dir=data)
    try:
        os.fchown(new, SERVER_USER, SERVER_USER)
        os.close(os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW))
    except PermissionError:
        return False
    finally:
        os.close(new)
        os.unlink(path)
    return True


def _unreachable_path(data: Path) -> str | None:
    """Return what the server's user cannot reach of Python, our code and the data, if anything."""
    try:
        subprocess.run(
            [sys.executable, "-c", _PROBE, str(data)],
            user=SERVER_USER,
            group=SERVER_USER,
            extra_groups=[],
            capture_output=True,
            text=True,
            check=True,
        )
    except OSError as error:
        return f"{error.strerror}: {error.filename}"
    except subprocess.CalledProcessError as error:
        return str(error.stderr).strip().splitlines()[-1]
    return None


def _give_ownership(path: Path, user: int) -> None:
    """Let a user own a file, or a folder with all in it, but nothing that a link points to.

    The server may put links here: root would give it whatever they name.
    """
    os.lchown(path, user, user)
    for _, folders, files, at in os.fwalk(path) if path.is_dir() else ():
        for name in (*folders, *files):
            os.chown(name, user, user, dir_fd=at, follow_symlinks=False)
