"""A split of one's own becomes a live phase: by one command, and by the lines that the server prints.

On real files; every line of the first steps is run as it is printed.
"""

import os
import re
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from tests.launcher.test_launch import Running, has_started, run_command
from tests.support.processes import free_port, plain_environment
from tests.support.realdata import file_path, require, split_path

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]
SPLIT = str(split_path("nuscenes-real"))
FILE = str(file_path("nuscenes-real", "recorded-human"))

Start = Callable[..., Running]


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    require()
    started = []

    def run(*options: str) -> Running:
        data = tmp_path / "data"
        command = [*run_command(data, free_port()), *options]
        splits = str(tmp_path / "splits")
        started.append(Running(data, 0, command=command, EXCEPTIONDRIVE_SPLITS_DIR=splits))
        started[-1].wait_until(has_started)
        return started[-1]

    yield run
    for each in started:
        if each.process.poll() is None:
            each.end()


def pasted(said: str, **words: str) -> str:
    """Run the first steps as they are printed, with the reader's own words in their places."""
    steps = said.partition("in another terminal:\n")[2].partition("  Logs:")[0]
    steps = re.sub(r"(--with-token)", r"\1 | tee /dev/stderr >told.txt", steps)
    steps = steps.replace("=edk_... ", '=$(grep -om1 "edk_[A-Za-z0-9_]*" told.txt) ')
    for place, word in words.items():
        steps = re.sub(rf"\b{place}\b", word, steps)
    root = Path(__file__).parents[2]
    environment = plain_environment(HOME=os.environ["HOME"], COLUMNS="200", NO_COLOR="1")
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", steps],
        cwd=root,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    (root / "told.txt").unlink(missing_ok=True)
    assert done.returncode == 0, steps + done.stdout + done.stderr
    return done.stdout


def test_one_command_makes_a_phase_of_a_split_that_takes_and_ranks_files(start: Start) -> None:
    running = start("--split", SPLIT)
    said = running.said.read_text()
    assert "split nuscenes-real (3181 samples) is phase nuscenes-real: 1 submission a day" in said
    assert "add-split" not in said
    told = pasted(said, FILE=FILE)
    assert "18.60" in told or "rank 1" in told.lower(), told
    assert running.end() == 0
    again = start("--split", SPLIT)
    assert "is phase nuscenes-real" in again.said.read_text(), "a second start changes nothing"


def test_without_a_phase_the_first_steps_lead_to_one(start: Start) -> None:
    said = start().said.read_text()
    assert "there is no open phase yet" in said
    told = pasted(said, SPLIT_FILE=SPLIT, NAME="nuscenes-real", FILE=FILE)
    assert "nuscenes-real: 3181 samples, sha256:" in told


def test_a_split_that_is_refused_stops_the_start_in_words(tmp_path: Path) -> None:
    file = tmp_path / "no-split.json"
    file.write_text('{"name": "x"}')
    data = tmp_path / "data"
    command = [*run_command(data, free_port()), "--split", str(file)]
    done = subprocess.run(
        command, env=plain_environment(), capture_output=True, text=True, check=False, timeout=200
    )
    assert done.returncode == 2
    assert "no-split.json is not a split" in done.stderr
    assert "Traceback" not in done.stderr
