"""Processes of the topology under a supervisor, as compose's `restart: unless-stopped` is one."""

import contextlib
import os
import signal
import subprocess
import threading
import time
from collections.abc import Mapping
from pathlib import Path

_RESTART_AFTER_S = 0.3


class Process:
    """One process in a group of its own; started again when it ends, unless held down."""

    def __init__(
        self, name: str, command: list[str], environment: Mapping[str, str], log: Path
    ) -> None:
        self.name = name
        self.command = command
        self.environment = dict(environment)
        self.log = log
        self.starts = 0
        self.exit_codes: list[int] = []
        self._is_wanted = False
        self._lock = threading.Lock()
        self._running: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        with self._lock:
            self._is_wanted = True
            if self._running is not None and self._running.poll() is None:
                return
            with self.log.open("ab") as stream:
                self._running = subprocess.Popen(
                    self.command,
                    env=self.environment,
                    stdin=subprocess.DEVNULL,
                    stdout=stream,
                    stderr=stream,
                    start_new_session=True,
                )
            self.starts += 1

    def supervise(self) -> None:
        """Start it again if it has ended by itself."""
        if not self._is_wanted or self._running is None or self._running.poll() is None:
            return
        self.exit_codes.append(self._running.returncode)
        self.kill_group()
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

    def send(self, number: signal.Signals) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.kill(self.pid, number)

    def send_group(self, number: signal.Signals) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.pid, number)

    def kill_children(self) -> int:
        children = self.children
        for child in children:
            with contextlib.suppress(ProcessLookupError):
                os.kill(child, signal.SIGKILL)
        return len(children)

    def kill_group(self) -> None:
        self.send_group(signal.SIGCONT)
        self.send_group(signal.SIGKILL)

    def hold_down(self) -> None:
        """Kill it, and keep it down until `start`."""
        self._is_wanted = False
        if self._running is not None:
            self.kill_group()
            self._running.wait()

    def stop(self, timeout_s: float = 30.0) -> int:
        """SIGTERM, as a supervisor stops it; return the exit code."""
        self._is_wanted = False
        assert self._running is not None
        self._running.terminate()
        try:
            return self._running.wait(timeout_s)
        finally:
            self.kill_group()


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
