"""Other users for processes, as compose gives them: numbers, no accounts needed."""

import os
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Users:
    """Who runs what: server and worker share a group, through which uploads are read."""

    server: int = 20001
    worker: int = 20002
    proxy: int = 20003
    group: int = 20001


def can_change_user() -> bool:
    return os.getuid() == 0 and shutil.which("setpriv") is not None


def as_user(user: int, group: int, command: list[str]) -> list[str]:
    """Return a command that runs another one as a user, in the same process."""
    changed = [
        *("setpriv", f"--reuid={user}", f"--regid={group}", "--clear-groups", "--no-new-privs"),
        *command,
    ]
    return showing_python(changed)


def showing_python(command: list[str]) -> list[str]:
    """Return a command that runs another one where every user may reach this Python."""
    closed = _closed_home()
    if closed is None:
        return command
    return ["unshare", "--mount", "sh", "-c", _SHOW_PYTHON, "sh", *closed, *command]


_SHOW_PYTHON = (
    # $1: a home that others may not enter, $2: the folder in it where this Python lives
    'home="$1"; python="$2"; shift 2; mount --bind "$python" /mnt && '
    'mount -t tmpfs -o mode=755 tmpfs "$home" && mkdir -p "$python" && '
    'mount --bind /mnt "$python" && exec "$@"'
)
"""Only this process sees these mounts; the home itself stays closed."""


def _closed_home() -> tuple[str, str] | None:
    """Return the home that hides this Python from other users, and the folder of Python in it."""
    python = Path(sys.base_prefix)
    for folder in reversed(python.parents):
        if not folder.stat().st_mode & 0o001:
            return str(folder), str(folder / python.relative_to(folder).parts[0])
    return None
