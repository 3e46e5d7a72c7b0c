"""Processes of the topology under a supervisor, as compose's `restart: unless-stopped` is one."""

import contextlib
import os
import signal
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from subprocess import DEVNULL, Popen

from tests.support.forked import Forked

_RESTART_AFTER_S = 0.3
_SEEN_WITHIN_S = 30.0


def signal_process(pid: int, number: signal.Signals) -> None:
    """Send a signal to a process that may have gone."""
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, number)


def signal_group(pid: int, number: signal.Signals) -> None:
    """Send a signal to every process of a group that may have gone."""
    with contextlib.suppress(ProcessLookupError):
        os.killpg(pid, number)


def state_of(pid: int) -> str:
    """Return how the system names the state of a process: `T` is stopped, `Z` is dead."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text()
    except (FileNotFoundError, ProcessLookupError):
        return "Z"
    return stat.rpartition(")")[2].split()[0]


def require_state(pid: int, state: str) -> None:
    """Fail unless a process comes to a state, as what was done to it wants."""
    deadline = time.monotonic() + _SEEN_WITHIN_S
    while (found := state_of(pid)) != state:
        assert time.monotonic() < deadline, f"process {pid} is in state {found}, not {state}"
        time.sleep(0.01)


def started(command: list[str], environment: Mapping[str, str], log: Path) -> Popen[bytes]:
    """Start a command in a group of its own."""
    with log.open("ab") as stream:
        return Popen(
            command,
            env=environment,
            stdin=DEVNULL,
            stdout=stream,
            stderr=stream,
            start_new_session=True,
        )


class Process:
    """One process in a group of its own; started again when it ends, unless held down."""

    def __init__(self, name: str, start: Callable[[], Popen[bytes] | Forked], log: Path) -> None:
        self.name = name
        self.log = log
        self._start = start
        self.starts = 0
        self.exit_codes: list[int] = []
        self._is_wanted = False
        self._lock = threading.Lock()
        self._running: Popen[bytes] | Forked | None = None

    def start(self) -> None:
        with self._lock:
            self._is_wanted = True
            if self._running is not None and self._running.poll() is None:
                return
            self._running = self._start()
            self.starts += 1

    def supervise(self) -> None:
        """Start it again if it has ended by itself."""
        with self._lock:  # else a start under way would be taken for an end
            running, is_wanted = self._running, self._is_wanted
        if not is_wanted or running is None or (code := running.poll()) is None:
            return
        self.exit_codes.append(code)
        signal_group(running.pid, signal.SIGKILL)
        time.sleep(_RESTART_AFTER_S)
        if self._is_wanted:
            self.start()

    @property
    def pid(self) -> int:
        assert self._running is not None
        return self._running.pid

    @property
    def children(self) -> list[int]:
        try:
            text = Path(f"/proc/{self.pid}/task/{self.pid}/children").read_text()
        except (FileNotFoundError, ProcessLookupError):
            return []
        return [int(child) for child in text.split()]

    def end(self, number: signal.Signals) -> None:
        """Send a signal that has to end it, and see that it did."""
        pid = self.pid
        signal_process(pid, number)
        require_state(pid, "Z")

    def freeze(self) -> None:
        """Stop its whole group, and see that it stands."""
        signal_group(self.pid, signal.SIGSTOP)
        for pid in (self.pid, *self.children):
            require_state(pid, "T")

    def thaw(self) -> None:
        signal_group(self.pid, signal.SIGCONT)

    def kill_children(self) -> int:
        """Kill the processes that it has started, and see them gone; return how many they were."""
        children = self.children
        for child in children:
            signal_process(child, signal.SIGKILL)
        for child in children:
            require_state(child, "Z")
        return len(children)

    def kill_group(self) -> None:
        """Kill it with all that it has started, and see it gone."""
        pid = self.pid
        signal_group(pid, signal.SIGCONT)
        signal_group(pid, signal.SIGKILL)
        require_state(pid, "Z")

    def hold_down(self) -> None:
        """Kill it, and keep it down until `start`."""
        self._is_wanted = False
        if self._running is not None:
            self.thaw()
            signal_group(self.pid, signal.SIGKILL)
            self._running.wait()

    def stop(self, timeout_s: float = 30.0) -> int:
        """SIGTERM, as a supervisor stops it; return the exit code."""
        self._is_wanted = False
        assert self._running is not None
        signal_process(self.pid, signal.SIGTERM)
        try:
            return self._running.wait(timeout_s)
        finally:
            signal_group(self.pid, signal.SIGKILL)


class Supervisor:
    """Watches processes from a thread."""

    def __init__(self) -> None:
        self.processes: list[Process] = []
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()

    def _watch(self) -> None:
        while not self._stopped.wait(0.1):
            for process in list(self.processes):
                process.supervise()

    def close(self) -> None:
        self._stopped.set()
        self._thread.join()
        for process in reversed(self.processes):
            process.hold_down()
