"""From a checked submission file to the named arrays that scoring takes."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exceptiondrive_schemas.check import CheckedDocument, PlanningDocument, StrategyAnswer
from exceptiondrive_schemas.strategy import ReminderRecord
from exceptiondrive_schemas.taxonomy import Strategy
from exceptiondrive_scoring.arrays import TrajectoryPairs
from exceptiondrive_scoring.split_arrays import STRATEGIES
from exceptiondrive_scoring.strategy import NO_ANSWER, StrategyAnswers

STRATEGY_CODE: dict[Strategy | None, int] = {s: code for code, s in enumerate(STRATEGIES)}
STRATEGY_CODE[None] = NO_ANSWER
PRESENCE_CODE: dict[bool | None, int] = {True: 1, False: 0, None: NO_ANSWER}
NOTHING_SAID = ReminderRecord()


def document_columns(
    document: CheckedDocument, sample_ids: Sequence[str]
) -> dict[str, NDArray[Any]]:
    """Return the answers of a sound file, one row per sample, in the order of `sample_ids`.

    Raises:
        KeyError: The file has no prediction for one of the samples.
    """
    if isinstance(document, PlanningDocument):
        shape = (len(sample_ids), document.n_waypoints, 2)
        flat = document.columns(sample_ids)
        rows = {side: np.frombuffer(flat[side]).reshape(shape) for side in flat}
        return TrajectoryPairs.from_columns(rows).columns()
    return strategy_answers([document.answers[sample_id] for sample_id in sample_ids]).columns()


def strategy_answers(answers: Sequence[StrategyAnswer]) -> StrategyAnswers:
    """Return answers and reminders as arrays, in the same order."""
    said = [answer.reminder or NOTHING_SAID for answer in answers]
    return StrategyAnswers(
        strategy=np.array([STRATEGY_CODE[each.strategy] for each in answers], dtype=np.int8),
        reminder_given=np.array([each.reminder is not None for each in answers], dtype=np.bool_),
        hazard_present=np.array([PRESENCE_CODE[r.hazard_present] for r in said], dtype=np.int8),
        hazard_type=np.array([(r.hazard_type or "").encode() for r in said], dtype="S64"),
        recommended=np.array([STRATEGY_CODE[r.recommended_strategy] for r in said], dtype=np.int8),
    )
