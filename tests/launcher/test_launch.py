"""The embedded default for real: start, submit by the sample, kill, restart."""

import json
import os
import signal
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.support.processes import free_port, plain_environment

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

SERVER = Path(sys.executable).parent / "exceptiondrive-server"
ROOT = Path(__file__).parents[2]


class Running:
    """A launcher of this test."""

    def __init__(self, data: Path, port: int, *options: str) -> None:
        self.port = port
        self.said = data.parent / "said.txt"
        with self.said.open("wb") as said:
            self.process = subprocess.Popen(
                [str(SERVER), "run", "--port", str(port), "--data", str(data), *options],
                stdout=said,
                stderr=subprocess.STDOUT,
                env=plain_environment(),
                cwd=ROOT,
            )

    def get(self, path: str) -> str:
        address = f"http://127.0.0.1:{self.port}{path}"
        with urllib.request.urlopen(address, timeout=5) as answer:
            return str(answer.read().decode())

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
def start(tmp_path: Path) -> Iterator[Callable[..., Running]]:
    running: list[Running] = []

    def run(*options: str) -> Running:
        running.append(Running(tmp_path / "data", free_port(), *options))
        return running[-1]

    yield run
    for one in running:
        if one.process.poll() is None:
            one.end()


def has_started(said: str) -> bool:
    return "ExceptionDrive runs at" in said


def ranked(running: Running) -> list[str]:
    board = json.loads(running.get("/api/v1/leaderboard?phase=sample"))
    return [entry["method"] for entry in board["entries"] if entry["rank"] is not None]


def reminder_effect(running: Running) -> dict[str, Any] | None:
    board = json.loads(running.get("/api/v1/leaderboard?phase=sample-strategy"))
    effects = [entry.get("reminder_effect") for entry in board["entries"]]
    return next((effect for effect in effects if effect), None)


def test_a_newcomer_sees_a_living_page_and_a_second_start_keeps_it(
    start: Callable[..., Running],
) -> None:
    first = start("--sample")
    first.wait_until(lambda said: "sample: 7 of 7 scored" in said)
    first.wait_until(lambda _: len(ranked(first)) >= 4)
    first.wait_until(lambda _: reminder_effect(first) is not None)
    methods = ranked(first)
    assert methods[0] in first.get("/")
    assert first.end() == 0
    assert "stopped; the data stays in" in first.said.read_text()
    second = start("--sample")
    second.wait_until(has_started)
    assert ranked(second) == methods
    assert second.end() == 0
    assert "of 7 scored" not in second.said.read_text()  # nothing is submitted twice


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks into /proc")
def test_whatever_dies_is_started_again_and_nothing_outlives_the_launcher(
    start: Callable[..., Running],
) -> None:
    running = start()
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


def test_a_second_launcher_and_a_taken_port_are_refused_in_one_sentence(
    start: Callable[..., Running], tmp_path: Path
) -> None:
    running = start()
    running.wait_until(has_started)
    same_data = [str(SERVER), "run", "--port", str(free_port()), "--data", str(tmp_path / "data")]
    refused = subprocess.run(same_data, capture_output=True, text=True, check=False)
    assert refused.returncode == 2
    assert "in use by another `exceptiondrive-server run`" in refused.stderr
    same_port = [str(SERVER), "run", "--port", str(running.port), "--data", str(tmp_path / "two")]
    refused = subprocess.run(same_port, capture_output=True, text=True, check=False)
    assert refused.returncode == 2
    assert f"port {running.port} is in use" in refused.stderr
