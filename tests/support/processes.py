"""Processes of the tests: free ports, patience, and what a process finds in its environment."""

import os
import socket
import sys
import time
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).parents[2]
BIN = Path(sys.executable).parent
"""Where the commands of this installation are."""


def free_port() -> int:
    """Return a port of the loopback on which nobody listens."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
    return port


def wait_until(
    is_so: Callable[[], object], what: str = "what was waited for", timeout_s: float = 60.0
) -> float:
    """Wait until a question is answered with yes; return the seconds, and fail if it never is."""
    begun = time.monotonic()
    while not is_so():
        waited_s = time.monotonic() - begun
        assert waited_s < timeout_s, f"waited {timeout_s:g} s in vain: {what}"
        time.sleep(min(0.005 + waited_s / 20, 0.1))
    return time.monotonic() - begun


def plain_environment(**more: str) -> dict[str, str]:
    """Return the environment of this process without settings of the project, but with these."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith("EXCEPTIONDRIVE_")}
    return kept | more
