"""The embedded default for real: what dies is started again, and all ends with the launcher."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from tests.support.processes import free_port, plain_environment

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

SERVER = Path(sys.executable).parent / "exceptiondrive-server"
ROOT = Path(__file__).parents[2]


class Running:
    """A launcher of this test."""

    def __init__(self, data: Path, port: int) -> None:
        self.said = data.parent / "said.txt"
        with self.said.open("wb") as said:
            self.process = subprocess.Popen(
                [str(SERVER), "run", "--port", str(port), "--data", str(data)],
                stdout=said,
                stderr=subprocess.STDOUT,
                env=plain_environment(),
                cwd=ROOT,
            )

    def wait_until(self, is_so: Callable[[str], bool]) -> None:
        deadline = time.monotonic() + 200
        while not is_so(self.said.read_text()):
            assert self.process.poll() is None, self.said.read_text()
            assert time.monotonic() < deadline, self.said.read_text()
            time.sleep(0.1)

    def children(self) -> dict[str, int]:
        """Pids of the direct children, by the last word of their name."""
        found = {}
        for stat in Path("/proc").glob("[0-9]*/stat"):
            try:
                parent = int(stat.read_text().rpartition(")")[2].split()[1])
                words = (stat.parent / "cmdline").read_bytes().decode().split("\0")
            except (FileNotFoundError, ProcessLookupError):
                continue
            if parent == self.process.pid:
                name = next((w for w in ("serve", "reconcile", "run") if w in words), "broker")
                found[name] = int(stat.parent.name)
        return found

    def end(self) -> int:
        self.process.send_signal(signal.SIGINT)
        return self.process.wait(60)


@pytest.fixture
def running(tmp_path: Path) -> Iterator[Running]:
    started = Running(tmp_path / "data", free_port())
    yield started
    if started.process.poll() is None:
        started.end()


def has_started(said: str) -> bool:
    return "ExceptionDrive runs at" in said


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks into /proc")
def test_whatever_dies_is_started_again_and_nothing_outlives_the_launcher(
    running: Running,
) -> None:
    running.wait_until(has_started)
    before = running.children()
    assert sorted(before) == ["broker", "reconcile", "run", "serve"]
    for pid in before.values():
        os.kill(pid, signal.SIGKILL)
    running.wait_until(lambda _: len(running.children()) == 4 and not is_any(before, running))
    after = running.children()
    running.process.kill()
    running.process.wait()
    deadline = time.monotonic() + 60
    while any(Path(f"/proc/{pid}").exists() for pid in after.values()):
        assert time.monotonic() < deadline
        time.sleep(0.1)


def is_any(before: dict[str, int], running: Running) -> bool:
    return bool(set(before.values()) & set(running.children().values()))
