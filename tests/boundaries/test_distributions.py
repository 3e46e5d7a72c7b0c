"""What an index asks of the three distributions before it takes them: by its own tool, strictly."""

import subprocess
import sys
from pathlib import Path

import pytest
from tests.support.distributions import DISTRIBUTIONS, build


@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_wheel_and_source_archive_could_be_published(name: str, tmp_path: Path) -> None:
    made = build(name, tmp_path)
    assert len(made) == 2
    command = [sys.executable, "-W", "ignore", "-m", "twine", "check", "--strict", *map(str, made)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("PASSED") == 2, done.stdout


def test_the_check_refuses_a_page_that_cannot_be_shown(tmp_path: Path) -> None:
    """Else nothing above would say anything."""
    (wheel,) = build("client", tmp_path, "sdist")[:1]
    wheel.write_bytes(b"no archive")
    command = [sys.executable, "-W", "ignore", "-m", "twine", "check", "--strict", str(wheel)]
    assert subprocess.run(command, capture_output=True, check=False).returncode != 0
