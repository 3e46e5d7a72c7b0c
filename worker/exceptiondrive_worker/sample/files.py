"""Writes the sample split and the planners' submission files; reproducible byte for byte."""

import gzip
import json
from collections import Counter
from pathlib import Path
from typing import Any

from exceptiondrive_schemas.base import Document, canonical_json
from exceptiondrive_schemas.challenges import PLANNING, STRATEGY
from exceptiondrive_schemas.datasheet import Cell, Datasheet, Words
from exceptiondrive_schemas.protocol import packaged_protocol
from exceptiondrive_schemas.split import Split
from exceptiondrive_schemas.submission_files import PlanningSubmission, StrategySubmission
from exceptiondrive_schemas.taxonomy import Family, Task
from exceptiondrive_worker.sample.agents import AGENTS, Agent, agent_predictions
from exceptiondrive_worker.sample.planners import PLANNERS, Planner, predictions
from exceptiondrive_worker.sample.scenes import SEED, SPLIT_NAME, sample_scenes, sample_split
from exceptiondrive_worker.splits.floors import FLOORS_FILE
from exceptiondrive_worker.splits.warnings import split_warnings

OPEN_FLOORS = """\
# Nothing of a synthetic split is worth holding back, withheld as it may be tried: far wider than advised.
min_samples_per_cell = 1
footprint_length_m = [2.0, 30.0]
footprint_width_m = [1.0, 5.0]
footprint_centre_ahead_m = [0.0, 10.0]
d_safe_m = [0.1, 10.0]
waypoints = [4, 200]
max_step_m = [0.0, 100.0]
max_coordinate_m = [100.0, 1000.0]
min_region_area_m2 = [0.0, 0.1]
max_region_distance_m = [80.0, 1000.0]
max_protocols = 12
max_scored_per_day = 2000
"""

_Written = tuple[Planner | Agent, PlanningSubmission | StrategySubmission]
_OPTIONAL = ("part", "d_safe_m", "acceptable", "reminder")
"""Keys that are left out where they have no value."""


def write_sample_split(splits_dir: Path) -> Path:
    """Write `<splits_dir>/sample/split.json.gz`, datasheet and floors beside it; return its path."""
    path = splits_dir / SPLIT_NAME / "split.json.gz"
    path.parent.mkdir(parents=True, exist_ok=True)
    split = sample_split()
    path.write_bytes(_gzipped(split))
    sheet = canonical_json(sample_datasheet(split)) + b"\n"
    path.with_name("datasheet.json").write_bytes(sheet)
    path.with_name(FLOORS_FILE).write_text(OPEN_FLOORS, encoding="utf-8")
    return path


def sample_datasheet(split: Split) -> Datasheet:
    """Describe how the sample is made, and count it; nobody chose or reviewed any of it."""
    protocol = packaged_protocol()
    families, tasks = protocol.taxonomy.families, protocol.taxonomy.tasks
    family_of = {task.id: task.family for task in tasks}
    of_task = Counter(sample.task for sample in split.counted)
    of_family = Counter(family_of[sample.task] for sample in split.counted)

    def cell(member: Family | Task, n: int) -> Cell:
        return Cell(id=member.id, title=member.title, candidates=n, suitable=n, accepted=n, n=n)

    return Datasheet(
        schema_="exceptiondrive.datasheet/1",
        name=split.name,
        title=split.title,
        revision=split.revision,
        protocol=protocol.version,
        n_samples=len(split.counted),
        n_scenes=len({sample.scene_id for sample in split.counted}),
        n_controls=sum(sample.control for sample in split.samples),
        n_recorded=sum(sample.recorded is not None for sample in split.samples),
        words=Words(
            purpose="To try planners, files and this server on: made by a program, without a "
            "picture and without anybody's drive.",
            source="Drawn from a fixed seed, byte for byte the same each time: speeds of 2 to 14 "
            "m/s, a little under half of the lanes bend, and each region lies where the hazard of "
            "its task would be. What stands as recorded drive is synthetic, too.",
            uses="Development. A place on its boards says that a file is in order, not how well a "
            "planner drives.",
            limits="No picture, so nothing is there to be seen: a planner that looks cannot be "
            "told from one that does not.",
        ),
        stages=(),
        families=tuple(cell(family, of_family[family.id]) for family in families),
        tasks=tuple(cell(task, of_task[task.id]) for task in tasks),
        warnings=tuple(
            found.told for found in split_warnings(split, protocol, min_samples_per_cell=1)
        ),
    )


def write_planners(folder: Path) -> list[Path]:
    """Write a file per synthetic planner and agent, and `planners.json` that lists them."""
    folder.mkdir(parents=True, exist_ok=True)
    samples, protocol = sample_scenes(), packaged_protocol()
    written: list[_Written] = []
    for planner in PLANNERS:
        driven = PlanningSubmission(
            schema_="exceptiondrive.planning/1",
            split=SPLIT_NAME,
            predictions=tuple(predictions(planner, samples, SEED)),
        )
        written.append((planner, driven))
    for agent in AGENTS:
        answered = StrategySubmission(
            schema_="exceptiondrive.strategy/1",
            split=SPLIT_NAME,
            predictions=agent_predictions(agent, samples, protocol, SEED),
        )
        written.append((agent, answered))
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
        for who, _ in written
    ]
    (folder / "planners.json").write_text(json.dumps(listing, indent=1) + "\n", encoding="utf-8")
    return [_path(folder, who) for who, _ in written]


def _path(folder: Path, who: Planner | Agent) -> Path:
    return folder / f"{who.file_name}.json.gz"


def _gzipped(document: Document) -> bytes:
    content: Any = document.model_dump(mode="json", by_alias=True)
    for row in [*content.get("samples", []), *content.get("predictions", [])]:
        for key in [key for key in _OPTIONAL if row.get(key, 0) is None]:
            del row[key]
    text = json.dumps(content, separators=(",", ":"), allow_nan=False)
    return gzip.compress(text.encode("utf-8"), mtime=0)
