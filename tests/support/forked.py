"""Processes forked from one that has only imported what they need: a start costs a fifth of one that imports.

Each is a process of its own, with its own session, environment and end.
"""

import contextlib
import gc
import multiprocessing
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

FORKS = multiprocessing.get_context("forkserver")
FORKS.set_forkserver_preload(
    [
        "exceptiondrive_server.app",
        "exceptiondrive_server.operations.cli",
        "exceptiondrive_worker.operator_cli",
        "exceptiondrive_worker.process",
        "pytest",
        "uvicorn",
    ]
)
_ONE_AT_A_TIME = threading.Lock()
"""`multiprocessing` would read how a process ended twice, if two threads asked."""


class Forked:
    """What `Popen` is to a process that was started: it leads a session, and appends to a log."""

    def __init__(
        self,
        run: Callable[[Sequence[str]], None],
        arguments: Sequence[str],
        environment: Mapping[str, str],
        log: Path,
    ) -> None:
        given = (run, list(arguments), dict(environment), str(log))
        self._process = FORKS.Process(target=_become, args=given, daemon=True)
        with _ONE_AT_A_TIME:
            self._process.start()
        assert self._process.pid is not None
        self.pid = self._process.pid
        with contextlib.suppress(ProcessLookupError):  # it has ended already
            while os.getsid(self.pid) != self.pid:
                time.sleep(0.001)

    @property
    def returncode(self) -> int | None:
        """How it ended, as `Popen` tells it."""
        return self.poll()

    def poll(self) -> int | None:
        with _ONE_AT_A_TIME:
            return self._process.exitcode

    def wait(self, timeout: float | None = None) -> int:
        """Wait for its end; raise `TimeoutExpired` as `Popen` does."""
        begun = time.monotonic()
        while (code := self.poll()) is None:
            if timeout is not None and time.monotonic() > begun + timeout:
                raise subprocess.TimeoutExpired("a forked process", timeout)
            time.sleep(0.01)
        return code


def _become(
    run: Callable[[Sequence[str]], None],
    arguments: Sequence[str],
    environment: Mapping[str, str],
    log: str,
) -> None:
    os.setsid()
    os.environ.clear()
    os.environ.update(environment)
    written = os.open(log, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
    for stream in (sys.stdout, sys.stderr):
        os.dup2(written, stream.fileno())
    os.close(written)
    gc.freeze()
    run(arguments)


def operate_worker(arguments: Sequence[str]) -> None:
    """Be the command `exceptiondrive-worker`."""
    from exceptiondrive_worker.operator_cli import main

    sys.argv = ["exceptiondrive-worker", *arguments]
    main()
