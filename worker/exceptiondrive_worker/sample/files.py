"""Writes the sample split and the planners' submission files; the same bytes every time."""

import gzip
import json
from pathlib import Path
from typing import Any

from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.planning import PlanningSubmission
from exceptiondrive_worker.sample.planners import PLANNERS, predictions
from exceptiondrive_worker.sample.scenes import SEED, SPLIT_NAME, sample_scenes, sample_split


def write_sample_split(splits_dir: Path) -> Path:
    """Write `<splits_dir>/sample/split.json.gz` and return its path."""
    path = splits_dir / SPLIT_NAME / "split.json.gz"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(_gzipped(sample_split()))
    return path


def write_planners(folder: Path) -> list[Path]:
    """Write one submission file per synthetic planner, and `planners.json` that lists them."""
    folder.mkdir(parents=True, exist_ok=True)
    samples = sample_scenes()
    paths, listing = [], []
    for planner in PLANNERS:
        submission = PlanningSubmission(
            schema_="exceptiondrive.planning/1",
            split=SPLIT_NAME,
            predictions=tuple(predictions(planner, samples, SEED)),
        )
        path = folder / f"{planner.file_name}.json.gz"
        path.write_bytes(_gzipped(submission))
        paths.append(path)
        listing.append(
            {
                "file": path.name,
                "method": planner.method,
                "description": planner.description,
                "is_reference": planner.is_reference,
            }
        )
    (folder / "planners.json").write_text(json.dumps(listing, indent=1) + "\n", encoding="utf-8")
    return paths


def _gzipped(document: Document) -> bytes:
    content: Any = document.model_dump(mode="json", by_alias=True)
    for sample in content.get("samples", []):
        for key in [key for key, value in sample.items() if value is None]:
            del sample[key]
    text = json.dumps(content, separators=(",", ":"), allow_nan=False)
    return gzip.compress(text.encode("utf-8"), mtime=0)
