"""The two challenges behind one interface, so that no caller branches on the challenge.

Answers and measurements pass as columns (named arrays over samples): what an upload reader makes,
what a store keeps, and what every function here takes.
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from exceptiondrive_schemas.challenges import PLANNING, STRATEGY, Challenge, ChallengeId
from exceptiondrive_schemas.drawing import EntryDrawings
from exceptiondrive_schemas.protocol import GeometrySection
from exceptiondrive_schemas.protocol import Protocol as ScoringProtocol
from exceptiondrive_scoring.aliases import BoolArray, Columns
from exceptiondrive_scoring.arrays import SplitArrays, TrajectoryPairs
from exceptiondrive_scoring.drawing import Drawer
from exceptiondrive_scoring.grade import SampleScores, grade
from exceptiondrive_scoring.measure import Measurements, measure
from exceptiondrive_scoring.plausibility import Plausibility, plausibility
from exceptiondrive_scoring.reminder import reminder_scores
from exceptiondrive_scoring.sensitivity import clearance_sensitivity
from exceptiondrive_scoring.strategy import (
    NO_ANSWER,
    StrategyAnswers,
    confusion,
    grade_strategies,
)

NamedRows = dict[str, dict[str, float | None]]


class ChallengeScoring(Protocol):
    """Measure, grade and what is published beside the score."""

    @property
    def challenge(self) -> Challenge:
        """Metrics in column order."""

    def measure(
        self, answers: Columns, split: SplitArrays, geometry: GeometrySection
    ) -> dict[str, NDArray[Any]]:
        """Columns that depend on answers, regions and geometry alone: kept by content."""

    def grade(
        self, measurements: Columns, split: SplitArrays, protocol: ScoringProtocol
    ) -> SampleScores:
        """Metric values of each sample, (N, M)."""

    def coverage(self, measurements: Columns) -> dict[str, float | None]:
        """Share of samples answered: `edited`, and `source` where there is one."""

    def plausibility(self, measurements: Columns, protocol: ScoringProtocol) -> Plausibility:
        """Shares and flags."""

    def extra(
        self, measurements: Columns, split: SplitArrays, protocol: ScoringProtocol
    ) -> NamedRows:
        """Further named rows of the score sheet."""

    def drawings(
        self,
        answers: Columns,
        measurements: Columns,
        sample_ids: Sequence[str],
        split: SplitArrays,
        protocol: ScoringProtocol,
    ) -> EntryDrawings | None:
        """Pictures of some samples, regions and all; None where there is nothing to draw."""


class PlanningScoring:
    """Trajectory pairs against hazard regions."""

    challenge = PLANNING

    def measure(
        self, answers: Columns, split: SplitArrays, geometry: GeometrySection
    ) -> dict[str, NDArray[Any]]:
        """Clearance, intrusion, shift, motion; from the columns `source` and `edited`."""
        pairs = TrajectoryPairs.from_columns(answers)
        return measure(pairs, split.prepared_regions, geometry).columns()

    def grade(
        self, measurements: Columns, split: SplitArrays, protocol: ScoringProtocol
    ) -> SampleScores:
        """HCC, UR, HPR and the CTS of each sample."""
        return grade(Measurements.from_columns(measurements), split, protocol)

    def coverage(self, measurements: Columns) -> dict[str, float | None]:
        """Share of edited and of source trajectories given."""
        return {
            "edited": _share(measurements["edited_given"]),
            "source": _share(measurements["source_given"]),
        }

    def plausibility(self, measurements: Columns, protocol: ScoringProtocol) -> Plausibility:
        """Shares of docs/protocol.md section 5."""
        return plausibility(Measurements.from_columns(measurements), protocol.plausibility)

    def extra(
        self, measurements: Columns, split: SplitArrays, protocol: ScoringProtocol
    ) -> NamedRows:
        """HCC with other required clearances."""
        return clearance_sensitivity(Measurements.from_columns(measurements), split, protocol)

    def drawings(
        self,
        answers: Columns,
        measurements: Columns,
        sample_ids: Sequence[str],
        split: SplitArrays,
        protocol: ScoringProtocol,
    ) -> EntryDrawings | None:
        """The worst and the middle sample of each family."""
        pairs = TrajectoryPairs.from_columns(answers)
        measured = Measurements.from_columns(measurements)
        return Drawer(sample_ids, pairs, measured, split, protocol).worst_and_middle()


class StrategyScoring:
    """Answers A to E against acceptable sets."""

    challenge = STRATEGY

    def measure(
        self, answers: Columns, split: SplitArrays, geometry: GeometrySection
    ) -> dict[str, NDArray[Any]]:
        """Answers need no geometry: they are their own measurements."""
        return StrategyAnswers.from_columns(answers).columns()

    def grade(
        self, measurements: Columns, split: SplitArrays, protocol: ScoringProtocol
    ) -> SampleScores:
        """Accuracy, under-warning, over-warning and missing of each sample."""
        return grade_strategies(StrategyAnswers.from_columns(measurements), split, protocol)

    def coverage(self, measurements: Columns) -> dict[str, float | None]:
        """Share of samples answered."""
        return {"edited": _share(measurements["strategy"] != NO_ANSWER), "source": None}

    def plausibility(self, measurements: Columns, protocol: ScoringProtocol) -> Plausibility:
        """Strategies have no motion to look at."""
        return Plausibility({})

    def extra(
        self, measurements: Columns, split: SplitArrays, protocol: ScoringProtocol
    ) -> NamedRows:
        """Confusion by acceptable set, and the reminder's scores where records were given."""
        answers = StrategyAnswers.from_columns(measurements)
        rows = {f"confusion_{name}": row for name, row in confusion(answers, split).items()}
        if answers.reminder_given.any():
            rows["reminder"] = reminder_scores(answers, split, protocol.taxonomy)
        return rows

    def drawings(
        self,
        answers: Columns,
        measurements: Columns,
        sample_ids: Sequence[str],
        split: SplitArrays,
        protocol: ScoringProtocol,
    ) -> EntryDrawings | None:
        """Strategies have no trajectories to draw."""
        return None


def _share(given: BoolArray) -> float:
    return float(np.mean(given))


SCORING: Mapping[ChallengeId, ChallengeScoring] = MappingProxyType(
    {scoring.challenge.id: scoring for scoring in (PlanningScoring(), StrategyScoring())}
)
