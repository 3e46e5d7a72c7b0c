"""The submission files of both challenges (docs/protocol.md sections 1 and 6)."""

from typing import Annotated, Literal

from pydantic import Field

from exceptiondrive_schemas.base import Document
from exceptiondrive_schemas.taxonomy import Strategy

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


MAX_TEXT_CHARACTERS = 2000
ShortText = Annotated[str, Field(max_length=MAX_TEXT_CHARACTERS)]
RiskLevel = Literal["none", "low", "medium", "high"]


class ReminderRecord(Document):
    """What the Reminder Agent says about one sample; presence, type and strategy are scored."""

    hazard_present: bool | None = None
    hazard_type: Annotated[str, Field(max_length=64)] | None = Field(
        default=None, description="a task id of the protocol's taxonomy"
    )
    relative_location: ShortText | None = None
    risk_level: RiskLevel | None = None
    evidence: ShortText | None = None
    safety_constraint: ShortText | None = None
    recommended_strategy: Strategy | None = None


class StrategyPrediction(Document):
    """The chosen strategy of one sample; `null` where the agent gave none."""

    sample_id: SampleId
    strategy: Strategy | None
    reminder: ReminderRecord | None = None


class StrategySubmission(Document):
    """A whole strategy file: every sample of the split exactly once, in any order."""

    schema_: Literal["exceptiondrive.strategy/1"] = Field(alias="schema")
    split: str
    predictions: tuple[StrategyPrediction, ...]
