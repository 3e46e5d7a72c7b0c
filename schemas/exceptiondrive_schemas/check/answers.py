"""The content of a sound file, ready for scoring: one answer per sample, without a second parse."""

from __future__ import annotations  # array[float] is not subscriptable at runtime before 3.12

import math
from array import array
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

from exceptiondrive_schemas.challenges import PLANNING, STRATEGY, ChallengeId
from exceptiondrive_schemas.submission_files import ReminderRecord
from exceptiondrive_schemas.taxonomy import Strategy


class TrajectoryPair(NamedTuple):
    """Waypoints of one sample, flat (x1, y1, x2, y2, ...), metres; None where missing."""

    source: array[float] | None
    edited: array[float] | None


class PairsOfColumns(Mapping[str, TrajectoryPair]):
    """Pairs by sample id of a file without missing trajectories, cut lazily out of its columns.

    Args:
        sample_ids: Ids of N samples, each once.
        source: N * T * 2 numbers, metres, one trajectory after the other.
        edited: The same.
        n_waypoints: T.
    """

    def __init__(
        self,
        sample_ids: Sequence[str],
        source: array[float],
        edited: array[float],
        n_waypoints: int,
    ) -> None:
        self.columns = {"source": source, "edited": edited}
        self._width = 2 * n_waypoints
        self._rows = dict(zip(sample_ids, range(len(sample_ids)), strict=True))

    def __getitem__(self, sample_id: str) -> TrajectoryPair:
        start = self._rows[sample_id] * self._width
        of_sample = slice(start, start + self._width)
        return TrajectoryPair(self.columns["source"][of_sample], self.columns["edited"][of_sample])

    def __iter__(self) -> Iterator[str]:
        return iter(self._rows)

    def __len__(self) -> int:
        return len(self._rows)


class StrategyAnswer(NamedTuple):
    """Strategy of one sample, None where missing, and the record of the Reminder Agent."""

    strategy: Strategy | None
    reminder: ReminderRecord | None


@dataclass(frozen=True)
class CheckedDocument:
    """A sound file: the name of its split, and its answer by sample id."""

    challenge: ClassVar[ChallengeId]
    split: str
    answers: Mapping[str, Any]


@dataclass(frozen=True)
class PlanningDocument(CheckedDocument):
    """A sound planning file: sample id to trajectories of `n_waypoints`."""

    challenge: ClassVar[ChallengeId] = PLANNING.id
    answers: Mapping[str, TrajectoryPair]
    n_waypoints: int

    def columns(self, sample_ids: Sequence[str]) -> dict[str, array[float]]:
        """Return the columns `source` and `edited` in the order of `sample_ids`.

        Returns:
            Two flat arrays of N * T * 2 float64, metres, NaN where missing; as numpy:
            `np.frombuffer(column).reshape(-1, T, 2)`.
        """
        answers = self.answers
        if isinstance(answers, PairsOfColumns) and list(answers) == sample_ids:
            return answers.columns
        missing = array("d", [math.nan]) * (2 * self.n_waypoints)
        source, edited = array("d"), array("d")
        for sample_id in sample_ids:
            pair = answers[sample_id]
            source.extend(missing if pair.source is None else pair.source)
            edited.extend(missing if pair.edited is None else pair.edited)
        return {"source": source, "edited": edited}


@dataclass(frozen=True)
class StrategyDocument(CheckedDocument):
    """A sound strategy file: sample id to strategy and reminder."""

    challenge: ClassVar[ChallengeId] = STRATEGY.id
    answers: Mapping[str, StrategyAnswer]
