"""The strategy challenge: answers against acceptable sets (docs/protocol.md section 6)."""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exceptiondrive_schemas.challenges import STRATEGY
from exceptiondrive_schemas.protocol import GradingSection, Protocol
from exceptiondrive_scoring.aliases import BoolArray, Columns, IntArray
from exceptiondrive_scoring.arrays import SplitArrays
from exceptiondrive_scoring.grade import SampleScores, sample_scores
from exceptiondrive_scoring.split_arrays import STRATEGIES

NO_ANSWER = -1


@dataclass(frozen=True)
class StrategyAnswers:
    """One answer per sample, and what its reminder record says; all arrays (N,).

    Attributes:
        strategy: int8, 0..4 for A..E, -1 where missing.
        reminder_given: Whether a reminder record came with the answer.
        hazard_present: int8, 1 yes, 0 no, -1 not said.
        hazard_type: Task id as bytes (S64), empty where not said.
        recommended: int8, 0..4 for A..E, -1 where not said.
    """

    strategy: NDArray[np.int8]
    reminder_given: BoolArray
    hazard_present: NDArray[np.int8]
    hazard_type: NDArray[np.bytes_]
    recommended: NDArray[np.int8]

    @classmethod
    def without_reminders(cls, strategy: IntArray) -> "StrategyAnswers":
        """Answers alone."""
        n_samples = len(strategy)
        none = np.full(n_samples, NO_ANSWER, dtype=np.int8)
        return cls(
            strategy=strategy.astype(np.int8),
            reminder_given=np.zeros(n_samples, dtype=np.bool_),
            hazard_present=none,
            hazard_type=np.zeros(n_samples, dtype="S64"),
            recommended=none,
        )

    @classmethod
    def from_columns(cls, columns: Columns) -> "StrategyAnswers":
        """Read what `columns` wrote."""
        return cls(**{field.name: columns[field.name] for field in fields(cls)})

    def columns(self) -> dict[str, NDArray[Any]]:
        """What a store keeps, one array per attribute."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


def caution_ranks(grading: GradingSection) -> IntArray:
    """Caution of the strategies A..E, (5,)."""
    return np.array([grading.caution[strategy.value] for strategy in STRATEGIES])


def under_warning_sets(acceptable: BoolArray, grading: GradingSection) -> BoolArray:
    """Which answers warn too little: not acceptable, and below the least cautious acceptable one.

    Args:
        acceptable: (N, 5) bool, A..E.
        grading: Caution ranks.

    Returns:
        (N, 5) bool.
    """
    caution = caution_ranks(grading)
    least = np.where(acceptable, caution, caution.max() + 1).min(axis=1)
    under: BoolArray = ~acceptable & (caution < least[:, None])
    return under


def grade_strategies(
    answers: StrategyAnswers, split: SplitArrays, protocol: Protocol
) -> SampleScores:
    """Accuracy, under-warning, over-warning and missing of every sample.

    A missing answer is wrong and under-warning, and counted apart.
    """
    missing = answers.strategy == NO_ANSWER
    under_set = under_warning_sets(split.acceptable, protocol.grading)
    correct = _look_up(split.acceptable, answers.strategy) & ~missing
    under = _look_up(under_set, answers.strategy) | missing
    by_key = {
        "accuracy": correct,
        "under_warning": under,
        "over_warning": ~correct & ~under,
        "missing": missing,
    }
    return sample_scores(STRATEGY.metric_keys, by_key)


def confusion(answers: StrategyAnswers, split: SplitArrays) -> dict[str, dict[str, float | None]]:
    """Count answers by acceptable set: `{"CD": {"n": 3, "A": 1, ..., "missing": 0}}`.

    The truth of a sample is a set of strategies, so the rows are the sets that occur.
    """
    power = 1 << np.arange(len(STRATEGIES))
    codes = split.acceptable @ power
    rows: dict[str, dict[str, float | None]] = {}
    for code in np.unique(codes):
        chosen = answers.strategy[codes == code]
        name = "".join(s.value for s, bit in zip(STRATEGIES, power, strict=True) if code & bit)
        row: dict[str, float | None] = {"n": float(len(chosen))}
        row |= {s.value: float(np.sum(chosen == i)) for i, s in enumerate(STRATEGIES)}
        rows[name] = row | {"missing": float(np.sum(chosen == NO_ANSWER))}
    return rows


def _look_up(table: BoolArray, strategy: IntArray) -> BoolArray:
    """Value of each row's own column; what a missing answer yields has no meaning."""
    chosen: BoolArray = np.take_along_axis(table, np.maximum(strategy, 0)[:, None], axis=1)[:, 0]
    return chosen
