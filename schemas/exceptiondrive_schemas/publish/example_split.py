"""The split, manifest and submission files of the examples, and JSON laid out for readers."""

import json
import re

from exceptiondrive_schemas.protocol import packaged_protocol
from exceptiondrive_schemas.split import Manifest, Split, SplitSample
from exceptiondrive_schemas.submission_files import (
    PlanningPrediction,
    PlanningSubmission,
    ReminderRecord,
    StrategyPrediction,
    StrategySubmission,
)
from exceptiondrive_schemas.taxonomy import Strategy

_PLAIN_LIST = re.compile(r"\[[^\[\]{}]*\]")
_LIST_OF_LISTS = re.compile(r"\[\s*(\[[^\[\]{}\n]*\](?:,\s*\[[^\[\]{}\n]*\])*)\s*\]")
_BLANKS = re.compile(r"\s+")
LINE_LENGTH = 100


def indented(text: str) -> str:
    """Return the same JSON document, laid out for reading, with a final newline."""
    text = json.dumps(json.loads(text), indent=2, ensure_ascii=False)
    return _LIST_OF_LISTS.sub(_on_one_line, _PLAIN_LIST.sub(_on_one_line, text)) + "\n"


def _on_one_line(match: re.Match[str]) -> str:
    flat = _BLANKS.sub(" ", match.group()).replace("[ ", "[").replace(" ]", "]")
    return flat if len(flat) <= LINE_LENGTH and '"' not in flat else match.group()


SAMPLE_IDS = ("example-0001", "example-0002", "example-0003")
NAME, TITLE = "example", "Three samples, one of each kind"

Waypoints = tuple[tuple[float, float], ...]

STEADY: Waypoints = ((3.0, 0.0), (6.0, 0.0), (9.0, 0.0), (12.0, 0.0), (15.0, 0.0), (18.0, 0.0))
BRAKING: Waypoints = ((2.5, 0.0), (4.5, 0.0), (6.0, 0.0), (7.0, 0.0), (7.5, 0.0), (7.5, 0.0))
SWERVING: Waypoints = ((3.0, 0.1), (6.0, 0.4), (9.0, 0.8), (12.0, 1.1), (15.0, 1.2), (18.0, 1.2))


def example_split() -> Split:
    """Three samples of two scenes, in three families."""
    return Split(
        schema_="exceptiondrive.split/1",
        name=NAME,
        title=TITLE,
        samples=(
            _sample(SAMPLE_IDS[0], "scene-1", "LB1", x_m=13.0, y_m=0.0),
            _sample(SAMPLE_IDS[1], "scene-1", "BG1", x_m=13.0, y_m=-0.5),
            _sample(SAMPLE_IDS[2], "scene-2", "SE1", x_m=20.0, y_m=1.0),
        ),
    )


def _sample(sample_id: str, scene_id: str, task: str, *, x_m: float, y_m: float) -> SplitSample:
    """A sample whose region begins at `x_m`, is 4 m long and 2 m wide, and is centred on `y_m`."""
    corners = ((0.0, -1.0), (4.0, -1.0), (4.0, 1.0), (0.0, 1.0))
    region = tuple((x_m + ahead, y_m + left) for ahead, left in corners)
    return SplitSample(sample_id=sample_id, scene_id=scene_id, task=task, region=region)


def example_manifest() -> Manifest:
    """What participants may know of the example split."""
    return Manifest.of(example_split(), packaged_protocol().geometry)


def example_planning() -> PlanningSubmission:
    """One trajectory stops in time, one drives into the hazard region, one is missing."""
    edited = (BRAKING, SWERVING, None)
    return PlanningSubmission(
        schema_="exceptiondrive.planning/1",
        split=NAME,
        predictions=tuple(
            PlanningPrediction(sample_id=sample_id, source=STEADY, edited=trajectory)
            for sample_id, trajectory in zip(SAMPLE_IDS, edited, strict=True)
        ),
    )


def example_strategy() -> StrategySubmission:
    """One answer with a reminder record, one without, one missing."""
    reminder = ReminderRecord(
        hazard_present=True,
        hazard_type="LB1",
        relative_location="ahead, in the ego lane",
        risk_level="high",
        evidence="a lorry stands across the lane with its warning lights on",
        safety_constraint="stop before it",
        recommended_strategy=Strategy.C,
    )
    first, second, third = SAMPLE_IDS
    return StrategySubmission(
        schema_="exceptiondrive.strategy/1",
        split=NAME,
        predictions=(
            StrategyPrediction(sample_id=first, strategy=Strategy.C, reminder=reminder),
            StrategyPrediction(sample_id=second, strategy=Strategy.A),
            StrategyPrediction(sample_id=third, strategy=None),
        ),
    )
