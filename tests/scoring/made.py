"""What tests of scoring give by hand: the metrics of the paper alone, and answers as numbers."""

import numpy as np

from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_scoring.aliases import IntArray
from exceptiondrive_scoring.strategy import NO_ANSWER, StrategyAnswers

KEYS = ("hcc", "ur", "hpr", "cts", "cts_x", "cts_y")
SIX_METRICS = PLANNING.model_copy(update={"metrics": tuple(map(PLANNING.metric, KEYS))})
"""The planning challenge, each metric a column."""


def answers_alone(strategy: IntArray) -> StrategyAnswers:
    """Answers without reminder records: (N,), 0..4 for A..E, -1 where missing."""
    none = np.full(len(strategy), NO_ANSWER, dtype=np.int8)
    return StrategyAnswers(
        strategy=strategy.astype(np.int8),
        reminder_given=np.zeros(len(strategy), dtype=np.bool_),
        hazard_present=none,
        hazard_type=np.zeros(len(strategy), dtype="S64"),
        recommended=none,
    )
