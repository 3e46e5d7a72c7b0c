"""Small documents of several folders' tests: manifests, splits, submissions, score sheets."""

import hashlib
import json
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.score_sheet import (
    BreakdownRow,
    Coverage,
    MetricRow,
    Plausibility,
    ProtocolRef,
    ScoreSheet,
)
from exceptiondrive_schemas.split import Manifest, Split, SplitRef

REVISION = "sha256:" + "5" * 64


def make_manifest(name: str = "sample", revision: str = REVISION) -> Manifest:
    return Manifest(
        schema_="exceptiondrive.manifest/1",
        name=name,
        title="Sample",
        revision=revision,
        waypoints=6,
        time_step_s=0.5,
        sample_ids=("s1", "s2", "s3"),
    )


def make_sheet(protocol_digest: str, row: MetricRow) -> ScoreSheet:
    """A sheet whose every aggregate says the same."""
    return ScoreSheet(
        challenge=PLANNING.id,
        protocol=ProtocolRef(version="1.0", digest=protocol_digest),
        split=SplitRef(name="sample", revision=REVISION),
        scorer_version="1",
        n=3,
        coverage=Coverage(edited=1.0, source=1.0),
        micro=row,
        macro_family=row,
        families={"sudden_emergence": BreakdownRow.of(3, row)},
        tasks={},
        plausibility=Plausibility(shares={"blind": 0.0}),
    )


Trajectory = list[list[float]]
Changes = Mapping[str, Mapping[str, Any]]


def make_board(*entries: BoardEntry, **changes: object) -> Board:
    """A board of planning; keyword arguments replace parts of it."""
    board = Board(
        challenge=PLANNING.id,
        phase="dev",
        split=SplitRef(name="sample", revision=REVISION),
        protocol=ProtocolRef(version="1.0", digest="sha256:" + "0" * 64),
        headline="macro_family",
        board=0,
        published_at=datetime(2026, 1, 2, tzinfo=UTC),
        n_samples=3,
        confidence=0.95,
        families=(),
        entries=entries,
    )
    return board.model_copy(update=changes)


def digest_of(data: bytes | str) -> str:
    """Return the name of a stored file."""
    raw = data.encode() if isinstance(data, str) else data
    return "sha256:" + hashlib.sha256(raw).hexdigest()


def region_ahead(near_m: float = 10.0, far_m: float | None = None) -> list[tuple[float, float]]:
    """Return a rectangle across the path, 2 m wide; 2 m long unless told where it ends."""
    far = near_m + 2.0 if far_m is None else far_m
    return [(near_m, -1.0), (far, -1.0), (far, 1.0), (near_m, 1.0)]


def split_document(samples: Changes, name: str = "tiny") -> Split:
    """Return a split of samples given as `{sample_id: changes}`; all else is as usual."""
    usual = {"scene_id": "scene-1", "task": "SE1", "region": region_ahead()}
    document = {
        "schema": "exceptiondrive.split/1",
        "name": name,
        "title": "A split",
        "samples": [{"sample_id": key, **usual, **changes} for key, changes in samples.items()],
    }
    return Split.model_validate_json(json.dumps(document))


def straight(speed_mps: float) -> Trajectory:
    """Return six waypoints straight ahead."""
    return [[round(speed_mps * step * 0.5, 4), 0.0] for step in range(1, 7)]


def planning_file(
    speeds_mps: Mapping[str, float],
    *,
    source_mps: float = 4.0,
    changes: Changes | None = None,
    split: str = "tiny",
) -> bytes:
    """Return a file in which everybody drives straight ahead, each edited sample at its speed."""
    predictions = [
        {
            "sample_id": key,
            "source": straight(source_mps),
            "edited": straight(speed_mps),
            **(changes or {}).get(key, {}),
        }
        for key, speed_mps in speeds_mps.items()
    ]
    return _submission("planning", split, predictions)


def strategy_file(strategies: Mapping[str, str | None], split: str = "tiny") -> bytes:
    """Return a file of one strategy a sample."""
    predictions = [{"sample_id": key, "strategy": value} for key, value in strategies.items()]
    return _submission("strategy", split, predictions)


def _submission(challenge: str, split: str, predictions: list[dict[str, Any]]) -> bytes:
    schema = f"exceptiondrive.{challenge}/1"
    return json.dumps({"schema": schema, "split": split, "predictions": predictions}).encode()
