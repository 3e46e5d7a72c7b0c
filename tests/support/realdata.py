"""Files of real planners, which may not be handed on: tests read them where they lie, or skip.

They lie beside the repository, in `shared/realdata`, or where REAL_PLANNER_FILES says. The made
extract (`tests/support/extract.py`) says the same for everybody.
"""

import gzip
import json
import os
from pathlib import Path

import pytest

FOLDER = Path(
    os.environ.get("REAL_PLANNER_FILES")
    or Path(__file__).parents[3].joinpath("shared", "realdata").resolve()
)
GOLDEN = Path(__file__).parents[1] / "golden"
PLANNERS = {
    "nuscenes-real": (
        "gpt-4.1",
        "gpt-4o",
        "claude-3.7-sonnet",
        "llama-3.2-11b",
        "qwen-2.5-7b",
        "recorded-human",
    ),
    "carla-pairs": ("cosmos", "ditto", "ppd"),
}
"""By split, the methods that were submitted on it."""
N_SAMPLES = {"nuscenes-real": 3181, "carla-pairs": 1257}
WITH_REFERENCE = (("nuscenes-real", "gpt-4.1"), ("carla-pairs", "cosmos"))
"""Files whose scores the protocol's author computed: `tests/golden/<split>.<method>.json`."""


def is_here() -> bool:
    """Whether the real files are on this machine."""
    return FOLDER.is_dir()


def require() -> None:
    """Skip the test, saying so, where the real files are absent."""
    if not is_here():
        pytest.skip(
            "the files of real planners are not on this machine (REAL_PLANNER_FILES names them)"
        )


def split_path(split: str) -> Path:
    """Return the file of a split, with its regions."""
    return FOLDER / split / "split.json.gz"


def file_path(split: str, method: str) -> Path:
    """Return what a method submitted on a split."""
    return FOLDER / split / f"{method}.json.gz"


def split_document(split: Path, recorded: Path | None) -> str:
    """Return a split file with what was really driven in it: the sources of another file."""
    document = json.loads(gzip.decompress(split.read_bytes()))
    if recorded is not None:
        given = json.loads(gzip.decompress(recorded.read_bytes()))["predictions"]
        drives = {each["sample_id"]: each["source"] for each in given}
        for sample in document["samples"]:
            sample["recorded"] = drives[sample["sample_id"]]
    return json.dumps(document)


def wrong_frame_path() -> Path:
    """Return a planner's file of another split whose frame is x right, y forward."""
    return FOLDER / "wrong-frame" / "agent-driver-x-right-y-forward.json.gz"
