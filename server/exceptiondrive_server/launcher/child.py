"""Child processes of the launcher: supervised ones, which never outlive it, and short-lived ones."""

import ctypes
import os
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

_PR_SET_PDEATHSIG = 1
_MAX_LOG_BYTES = 10 * 2**20
_STEADY_AFTER_S = 30.0
_LONGEST_PAUSE_S = 30.0
_LINES_SHOWN = 12


Say = Callable[[str], None]
"""Tells whoever started this."""


class LaunchError(Exception):
    """The launcher cannot go on; `str()` says why and what to do."""


def run_step(command: list[str], environment: Mapping[str, str]) -> str:
    """Run a command of ours to its end and return what it printed.

    Raises:
        LaunchError: It failed; its own words are part of the text.
    """
    done = subprocess.run(
        command, env=dict(environment), capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        raise LaunchError(f"`{' '.join(command[1:])}` failed:\n{done.stderr or done.stdout}")
    return done.stdout


@dataclass(frozen=True)
class ChildPlan:
    """What to run: name, command and the whole environment."""

    name: str
    command: list[str]
    environment: Mapping[str, str] = field(repr=False)
    log: Path
    user: int | None = None
    """Who runs it, in a group of the same number; whoever runs the launcher by default."""


class Child:
    """A process that is started again, with growing pauses, when it ends by itself."""

    def __init__(self, plan: ChildPlan) -> None:
        self.plan = plan
        self.starts = 0
        self._process: subprocess.Popen[bytes] | None = None
        self._started_at = 0.0
        self._pause_s = 1.0
        self._start_again_at = 0.0

    def start(self) -> None:
        """Start the process in a group of its own."""
        _rotate(self.plan.log)
        with self.plan.log.open("ab") as log:
            self._process = subprocess.Popen(
                self.plan.command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=dict(self.plan.environment),
                start_new_session=True,
                user=self.plan.user,
                group=self.plan.user,
                extra_groups=None if self.plan.user is None else [],
                preexec_fn=die_with_parent(os.getpid()),  # noqa: PLW1509 - no threads here
            )
        self.starts += 1
        self._started_at = time.monotonic()

    @property
    def pid(self) -> int:
        """Process id, which is also that of the group."""
        assert self._process is not None
        return self._process.pid

    @property
    def is_alive(self) -> bool:
        """Whether the process runs."""
        return self._process is not None and self._process.poll() is None

    def check(self) -> str | None:
        """Restart a dead process when its pause is over; return a message to print, if any."""
        if self.is_alive:
            return None
        if self._process is not None:
            return self._note_death()
        if time.monotonic() >= self._start_again_at:
            self.start()
        return None

    def end(self) -> None:
        """Ask the process to end; what it has started is its own to end, as a worker does after a job."""
        if self._process is not None:
            self._process.terminate()

    def kill(self) -> None:
        """Kill the whole group."""
        if self._process is not None:
            _kill_group(self._process.pid)

    def wait(self, deadline: float) -> bool:
        """Whether the process has ended before `deadline` (of `time.monotonic`)."""
        if self._process is None:
            return True
        try:
            self._process.wait(max(0.0, deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            return False
        return True

    def last_lines(self) -> str:
        """Return the end of the log."""
        if not self.plan.log.exists():
            return ""
        with self.plan.log.open(encoding="utf-8", errors="replace") as log:
            return "".join(deque(log, maxlen=_LINES_SHOWN)).rstrip()

    def _note_death(self) -> str:
        assert self._process is not None
        code = self._process.returncode
        _kill_group(self._process.pid)  # what it leaves behind
        self._process = None
        if time.monotonic() - self._started_at > _STEADY_AFTER_S:
            self._pause_s = 1.0
        pause_s, self._pause_s = self._pause_s, min(2 * self._pause_s, _LONGEST_PAUSE_S)
        self._start_again_at = time.monotonic() + pause_s
        how = f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with {code}"
        return f"{self.plan.name} {how}; starting it again in {pause_s:.0f} s"


def _kill_group(group: int) -> None:
    try:
        os.killpg(group, signal.SIGKILL)
    except (ProcessLookupError, PermissionError):
        return


def die_with_parent(launcher_pid: int) -> Callable[[], None] | None:
    """Return what the child runs first: Linux then ends it when the launcher is killed."""
    if not sys.platform.startswith("linux"):
        return None
    libc = ctypes.CDLL(None, use_errno=True)

    def prepare() -> None:
        libc.prctl(_PR_SET_PDEATHSIG, int(signal.SIGTERM), 0, 0, 0)
        if os.getppid() != launcher_pid:  # it was killed before the line above
            os._exit(1)

    return prepare


def _rotate(log: Path) -> None:
    if log.exists() and log.stat().st_size > _MAX_LOG_BYTES:
        log.replace(log.with_suffix(".log.1"))
