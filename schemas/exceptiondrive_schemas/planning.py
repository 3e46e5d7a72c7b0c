"""The planning submission file `exceptiondrive.planning/1` (docs/protocol.md section 1)."""

from typing import Annotated, Literal

from pydantic import Field

from exceptiondrive_schemas.base import Document

Coordinate = Annotated[float, Field(allow_inf_nan=False, description="metres, ego frame at t = 0")]
Waypoint = Annotated[
    tuple[Coordinate, Coordinate], Field(description="[x, y]: x forward, y left, in metres")
]
Trajectory = Annotated[
    tuple[Waypoint, ...],
    Field(description="waypoints at t = 0.5, 1.0, ... s; protocol 1.0 takes exactly six"),
]
SampleId = Annotated[str, Field(min_length=1, max_length=128)]


class PlanningPrediction(Document):
    """The source and the edited trajectory of one sample; `null` where the planner gave none."""

    sample_id: SampleId
    source: Trajectory | None
    edited: Trajectory | None


class PlanningSubmission(Document):
    """A whole trajectory file: every sample of the split exactly once, in any order."""

    schema_: Literal["exceptiondrive.planning/1"] = Field(alias="schema")
    split: str
    predictions: tuple[PlanningPrediction, ...]
