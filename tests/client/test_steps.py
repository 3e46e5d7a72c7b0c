"""The steps of a long evaluation: told on a terminal, and there alone."""

import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from exceptiondrive.evaluation import score, sound_file

MakeFile = Callable[..., Path]
CODE = """
import sys
from exceptiondrive.cli import app, progress
progress.STEPS_AFTER_S = {after_s}
app(sys.argv[1:])
"""


def evaluated(after_s: float, *arguments: str | Path) -> str:
    """What a terminal shows on stderr while a file is evaluated."""
    return shown_by(CODE.format(after_s=after_s), "evaluate", *arguments)


def shown_by(code: str, *arguments: str | Path) -> str:
    """What a terminal shows on stderr of a program."""
    import pty

    main_end, terminal = pty.openpty()
    command = [sys.executable, "-c", code, *arguments]
    done = subprocess.run(
        command,
        stdout=subprocess.PIPE,
        stderr=terminal,
        env={**os.environ, "TERM": "xterm-256color", "COLUMNS": "100"},
        check=False,
    )
    assert done.returncode == 0
    os.write(terminal, b"|end|")
    os.close(terminal)
    shown = b""
    while not shown.endswith(b"|end|"):
        shown += os.read(main_end, 65536)
    os.close(main_end)
    return shown.removesuffix(b"|end|").decode()


def test_the_steps_are_told_in_their_order(planning_file: MakeFile, split_file: Path) -> None:
    steps: list[str] = []
    sound = sound_file(planning_file(), split_file, None)
    score(*sound[:3], steps.append)
    assert steps == [f"measuring {len(sound.split.counted)} samples", "grading"]


@pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals are a POSIX matter")
def test_a_terminal_is_told_what_goes_on(planning_file: MakeFile, split_file: Path) -> None:
    file = planning_file()
    shown = evaluated(0, file, "--split", split_file)
    assert "grading" in shown
    assert re.search(r"\d:\d\d:\d\d", shown), "how long it has taken"
    assert evaluated(0, file, "--split", split_file, "--json") == ""
    assert evaluated(600, file, "--split", split_file) == "", "what is quick says nothing"


UPLOAD = """
import time
from exceptiondrive.cli.progress import transfer_bar
with transfer_bar("uploading", "planner.json") as bar:
    for done in range(10):
        bar(done * 1_000_000, 9_000_000)
        time.sleep(0.05)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="pseudo-terminals are a POSIX matter")
def test_a_bar_tells_rate_and_time_left() -> None:
    shown = shown_by(UPLOAD)
    assert "uploading planner.json" in shown
    assert re.search(r"[\d.]+/9\.0 MB", shown)
    assert re.search(r"[\d.]+ [kM]B/s", shown), "the rate"
    assert re.search(r"0:00:\d\d", shown), "the time left"


def test_a_pipe_is_told_nothing(planning_file: MakeFile, split_file: Path) -> None:
    command: list[str | Path] = [sys.executable, "-c", CODE.format(after_s=0)]
    done = subprocess.run(
        [*command, "evaluate", planning_file(), "--split", split_file],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stderr == ""
    assert "HCC" in done.stdout
