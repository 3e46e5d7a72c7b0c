"""Reminder records: hazard presence and type, recommended strategy (docs/protocol.md section 6)."""

import numpy as np

from exceptiondrive_schemas.taxonomy import Taxonomy
from exceptiondrive_scoring.aliases import BoolArray, IntArray
from exceptiondrive_scoring.arrays import SplitArrays
from exceptiondrive_scoring.strategy import NO_ANSWER, StrategyAnswers

PRESENT, ABSENT = 1, 0


def reminder_scores(
    answers: StrategyAnswers,
    split: SplitArrays,
    taxonomy: Taxonomy,
    hazard_is_present: BoolArray | None = None,
) -> dict[str, float | None]:
    """Score what the reminder records say, over the samples that carry one.

    A record that leaves something unsaid is wrong in it: an unnamed type is no hit, an unsaid
    presence is no alarm.

    Args:
        answers: Answers with their reminder records.
        split: Acceptable strategies, tasks and families.
        taxonomy: Task ids in the order of `split.task_index`.
        hazard_is_present: (N,) the truth; by default every sample has its hazard, as edited
            samples do.

    Returns:
        `given` (share of samples with a record), `presence_precision`, `presence_recall`,
        `type_task_accuracy`, `type_family_accuracy`, `strategy_accuracy`; None where undefined.
    """
    given = answers.reminder_given
    truth = np.ones_like(given) if hazard_is_present is None else hazard_is_present
    alarm = answers.hazard_present == PRESENT
    task = _task_positions(answers, taxonomy)
    named = task != NO_ANSWER
    family = split.family_index == _families(taxonomy)[task]
    recommended = np.maximum(answers.recommended, 0)[:, None].astype(np.intp)
    fits = np.take_along_axis(split.acceptable, recommended, axis=1)[:, 0]
    return {
        "given": _share(given, np.ones_like(given)),
        "presence_precision": _share(truth, given & alarm),
        "presence_recall": _share(alarm, given & truth),
        "type_task_accuracy": _share(task == split.task_index, given & truth),
        "type_family_accuracy": _share(family & named, given & truth),
        "strategy_accuracy": _share(fits & (answers.recommended != NO_ANSWER), given),
    }


def _families(taxonomy: Taxonomy) -> IntArray:
    ids = [family.id for family in taxonomy.families]
    return np.array([ids.index(task.family) for task in taxonomy.tasks])


def _task_positions(answers: StrategyAnswers, taxonomy: Taxonomy) -> IntArray:
    """Position of each named hazard type in the taxonomy, -1 where it is not one of its tasks."""
    position = {task.id.encode(): index for index, task in enumerate(taxonomy.tasks)}
    named, inverse = np.unique(answers.hazard_type, return_inverse=True)
    return np.array([position.get(bytes(name), NO_ANSWER) for name in named])[inverse]


def _share(which: BoolArray, among: BoolArray) -> float | None:
    n = int(np.count_nonzero(among))
    return int(np.count_nonzero(which & among)) / n if n else None
