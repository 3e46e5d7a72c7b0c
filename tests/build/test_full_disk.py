"""A disk on which no file may grow any more: one clear sentence, and nothing of before is lost."""

import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest
from tests.build.test_resume import RUN
from tests.build.test_stages import report, walked
from tests.support.stand_in import StandIn

from exceptiondrive_build.values import Edited


@pytest.mark.parametrize(("stage", "room"), [("screen", 6_000), ("edit", 12_000)])
def test_a_full_disk_stops_the_run_in_one_sentence_and_loses_nothing(
    shop: Path, stand_in: StandIn, stage: str, room: int
) -> None:
    if stage == "edit":
        report(shop, "screen")
    before = {key: candidate.screened for key, candidate in walked(shop).items()}

    def no_growth() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (room, room))

    done = subprocess.run(
        [sys.executable, "-c", RUN, "run", stage, "-w", str(shop)],
        env=os.environ
        | {"PYTHONDONTWRITEBYTECODE": "1"},  # else the limit cuts bytecode short, too
        preexec_fn=no_growth,
        check=False,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    assert "kept" in done.stderr
    assert {k: c.screened for k, c in walked(shop).items() if before[k]} == {
        k: value for k, value in before.items() if value
    }
    assert report(shop, stage)["still_open"] == 0
    left = [path for path in (shop / "images").iterdir() if path.suffix == ".part"]
    assert left == []
    if stage == "edit":
        suitable = [c for c in walked(shop).values() if c.is_suitable]
        assert all(isinstance(candidate.edited, Edited) for candidate in suitable)
