"""Supervised processes: started again when they die, gone when the launcher is."""

import os
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from tests.support.processes import wait_until

from exceptiondrive_server.launcher.child import Child, ChildPlan

SLEEPER = "import time; print('up', flush=True); time.sleep(600)"


@pytest.fixture
def make_child(tmp_path: Path) -> Iterator[Callable[[str], Child]]:
    made: list[Child] = []

    def make(code: str) -> Child:
        command = [sys.executable, "-c", code]
        made.append(Child(ChildPlan("child", command, dict(os.environ), tmp_path / "child.log")))
        return made[-1]

    yield make
    for child in made:
        child.kill()
        child.wait(time.monotonic() + 5)


def is_running(pid: int) -> bool:
    state = Path(f"/proc/{pid}/stat")
    return state.exists() and state.read_text().rpartition(")")[2].split()[0] != "Z"


def test_a_child_that_dies_is_started_again_and_its_death_is_told(
    make_child: Callable[[str], Child],
) -> None:
    child = make_child(SLEEPER)
    child.start()
    assert child.check() is None
    first = child.pid
    os.kill(first, signal.SIGKILL)
    wait_until(lambda: not child.is_alive)
    assert child.check() == "child was ended by SIGKILL; starting it again in 1 s"
    wait_until(lambda: child.check() is None and child.is_alive)
    assert child.pid != first
    assert child.starts == 2


def test_a_child_that_dies_at_once_is_started_with_growing_pauses(
    make_child: Callable[[str], Child],
) -> None:
    child = make_child("import sys; print('no such table'); sys.exit(3)")
    news: list[str] = []
    while len(news) < 2:
        told = child.check()
        if told is not None:
            news.append(told)
        time.sleep(0.02)
    assert news == [
        "child ended with 3; starting it again in 1 s",
        "child ended with 3; starting it again in 2 s",
    ]
    assert child.last_lines() == "no such table\nno such table"


def test_a_child_that_is_asked_to_end_lets_what_it_has_started_finish(
    make_child: Callable[[str], Child],
) -> None:
    """As a worker does with the process that has a job."""
    inner = "import sys; sys.stdin.read()"
    child = make_child(
        "import signal, subprocess, sys\n"
        f"inner = subprocess.Popen([sys.executable, '-c', {inner!r}], stdin=subprocess.PIPE)\n"
        "def finish(*_):\n"
        "    inner.communicate()\n"
        "    print('inner ended with', inner.returncode)\n"
        "    sys.exit(0)\n"
        "signal.signal(signal.SIGTERM, finish)\n"
        "print('up', flush=True)\n"
        "while True:\n"
        "    signal.pause()"
    )
    child.start()
    wait_until(lambda: child.last_lines() == "up")
    child.end()
    assert child.wait(time.monotonic() + 30)
    assert child.last_lines() == "up\ninner ended with 0"


def test_killing_a_child_ends_what_it_has_started(make_child: Callable[[str], Child]) -> None:
    child = make_child(
        "import subprocess, sys, time\n"
        f"inner = subprocess.Popen([sys.executable, '-c', {SLEEPER!r}])\n"
        "print(inner.pid, flush=True)\n"
        "time.sleep(600)"
    )
    child.start()
    wait_until(lambda: child.last_lines().split("\n")[0].isdigit())
    inner = int(child.last_lines().split("\n")[0])
    child.end()
    assert child.wait(time.monotonic() + 30)
    assert is_running(inner)
    child.kill()
    wait_until(lambda: not is_running(inner))


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux tells children")
def test_a_launcher_that_is_killed_leaves_no_orphan(tmp_path: Path) -> None:
    launcher = subprocess.Popen(
        [
            sys.executable,
            "-c",
            textwrap.dedent(
                f"""
                import os, pathlib, sys, time
                from exceptiondrive_server.launcher.child import Child, ChildPlan
                command = [sys.executable, "-c", {SLEEPER!r}]
                log = pathlib.Path({str(tmp_path / "child.log")!r})
                child = Child(ChildPlan("child", command, dict(os.environ), log))
                child.start()
                print(child.pid, flush=True)
                time.sleep(600)
                """
            ),
        ],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert launcher.stdout is not None
    pid = int(launcher.stdout.readline())
    assert is_running(pid)
    launcher.kill()
    launcher.wait()
    launcher.stdout.close()
    wait_until(lambda: not is_running(pid))
