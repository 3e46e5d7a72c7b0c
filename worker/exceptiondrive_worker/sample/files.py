"""Writes the sample split and the planners' submission files; the same bytes every time."""

import gzip
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.challenges import PLANNING, STRATEGY
from exceptiondrive_schemas.protocol import packaged_protocol
from exceptiondrive_schemas.submission_files import PlanningSubmission, StrategySubmission
from exceptiondrive_worker.sample.agents import AGENTS, Agent, agent_predictions
from exceptiondrive_worker.sample.planners import PLANNERS, Planner, predictions
from exceptiondrive_worker.sample.scenes import SEED, SPLIT_NAME, sample_scenes, sample_split

_Written = tuple[Planner | Agent, PlanningSubmission | StrategySubmission]
_OPTIONAL = ("part", "d_safe_m", "acceptable", "reminder")
"""Keys that are left out where they say nothing."""


def write_sample_split(splits_dir: Path) -> Path:
    """Write `<splits_dir>/sample/split.json.gz` and return its path."""
    path = splits_dir / SPLIT_NAME / "split.json.gz"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(_gzipped(sample_split()))
    return path


def write_planners(folder: Path) -> list[Path]:
    """Write a file per synthetic planner and agent, and `planners.json` that lists them."""
    folder.mkdir(parents=True, exist_ok=True)
    written: list[_Written] = [*_planner_files(), *_agent_files()]
    for who, submission in written:
        _path(folder, who).write_bytes(_gzipped(submission))
    listing = [
        {
            "file": _path(folder, who).name,
            "challenge": (PLANNING if isinstance(who, Planner) else STRATEGY).id,
            "method": who.method,
            "description": who.description,
            "without_reminder": who.without_reminder if isinstance(who, Agent) else "",
        }
        for who, submission in written
    ]
    (folder / "planners.json").write_text(json.dumps(listing, indent=1) + "\n", encoding="utf-8")
    return [_path(folder, who) for who, _ in written]


def _path(folder: Path, who: Planner | Agent) -> Path:
    return folder / f"{who.file_name}.json.gz"


def _planner_files() -> Iterator[tuple[Planner, PlanningSubmission]]:
    samples = sample_scenes()
    for planner in PLANNERS:
        yield (
            planner,
            PlanningSubmission(
                schema_="exceptiondrive.planning/1",
                split=SPLIT_NAME,
                predictions=tuple(predictions(planner, samples, SEED)),
            ),
        )


def _agent_files() -> Iterator[tuple[Agent, StrategySubmission]]:
    samples, protocol = sample_scenes(), packaged_protocol()
    for agent in AGENTS:
        yield (
            agent,
            StrategySubmission(
                schema_="exceptiondrive.strategy/1",
                split=SPLIT_NAME,
                predictions=agent_predictions(agent, samples, protocol, SEED),
            ),
        )


def _gzipped(document: Document) -> bytes:
    content: Any = document.model_dump(mode="json", by_alias=True)
    for row in [*content.get("samples", []), *content.get("predictions", [])]:
        for key in [key for key in _OPTIONAL if row.get(key, 0) is None]:
            del row[key]
    text = json.dumps(content, separators=(",", ":"), allow_nan=False)
    return gzip.compress(text.encode("utf-8"), mtime=0)
