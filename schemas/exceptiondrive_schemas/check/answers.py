"""What a sound file says, ready for scoring: one answer per sample, without a second parse."""

from __future__ import annotations  # array[float] is no runtime type before 3.12

import math
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

from exceptiondrive_schemas.challenges import ChallengeId
from exceptiondrive_schemas.strategy import ReminderRecord
from exceptiondrive_schemas.taxonomy import Strategy


class TrajectoryPair(NamedTuple):
    """Waypoints of one sample, flat (x1, y1, x2, y2, ...), metres; None where missing."""

    source: array[float] | None
    edited: array[float] | None


class StrategyAnswer(NamedTuple):
    """Strategy of one sample, None where missing, and what the Reminder Agent said."""

    strategy: Strategy | None
    reminder: ReminderRecord | None


@dataclass(frozen=True)
class PlanningDocument:
    """A sound planning file.

    Attributes:
        split: Name of the split.
        n_waypoints: T.
        answers: Sample id to trajectories.
    """

    challenge: ClassVar[ChallengeId] = ChallengeId.PLANNING
    split: str
    n_waypoints: int
    answers: Mapping[str, TrajectoryPair]

    def columns(self, sample_ids: Sequence[str]) -> dict[str, array[float]]:
        """Columns `source` and `edited` in the order of `sample_ids`.

        Returns:
            Two flat arrays of N * T * 2 float64, metres, NaN where missing; as numpy:
            `np.frombuffer(column).reshape(-1, T, 2)`.
        """
        missing = array("d", [math.nan]) * (2 * self.n_waypoints)
        source, edited = array("d"), array("d")
        for sample_id in sample_ids:
            pair = self.answers[sample_id]
            source.extend(missing if pair.source is None else pair.source)
            edited.extend(missing if pair.edited is None else pair.edited)
        return {"source": source, "edited": edited}


@dataclass(frozen=True)
class StrategyDocument:
    """A sound strategy file.

    Attributes:
        split: Name of the split.
        answers: Sample id to strategy and reminder.
    """

    challenge: ClassVar[ChallengeId] = ChallengeId.STRATEGY
    split: str
    answers: Mapping[str, StrategyAnswer]


CheckedDocument = PlanningDocument | StrategyDocument
