"""The effect of a reminder: an entry against its linked counterpart, sample by sample.

The two are compared like any two entries (`comparisons`), and only rounded differences leave.
"""

from collections.abc import Sequence

from exceptiondrive_schemas.challenges import Challenge
from exceptiondrive_schemas.score_sheet import MetricRow, ReminderEffect
from exceptiondrive_worker.boards.comparisons import (
    Standing,
    kept_comparison,
    rounded_difference,
)
from exceptiondrive_worker.boards.rounding import Rounding
from exceptiondrive_worker.stages import Stages

_VERDICTS = {
    "A is better": "better with the reminder",
    "B is better": "worse with the reminder",
    "A is higher": "higher with the reminder",
    "B is higher": "lower with the reminder",
}


def reminder_effects(
    stages: Stages, entries: Sequence[Standing], rounding: Rounding
) -> list[ReminderEffect | None]:
    """Return the published effect of each entry of one board, in order.

    None if it is linked to no entry of the board, or to one that has reminder records of its own.
    """
    plain = {
        record.submission_id: (target, record)
        for target, record in entries
        if not record.sheet.has_reminders
    }
    found = (plain.get(record.linked_to or "") for _, record in entries)
    return [
        None if without_it is None else _effect(stages, with_it, without_it, rounding)
        for with_it, without_it in zip(entries, found, strict=True)
    ]


def _effect(
    stages: Stages, with_it: Standing, without_it: Standing, rounding: Rounding
) -> ReminderEffect:
    (target, record), (_, linked) = with_it, without_it
    found = kept_comparison(stages, with_it, without_it).overall
    effect = ReminderEffect(
        without=linked.submission_id,
        without_method=linked.method,
        differences={
            key: row.model_copy(update={"verdict": _VERDICTS.get(row.verdict, row.verdict)})
            for key, row in found.items()
        },
    )
    headline = target.protocol.grading.headline
    rows = [sheet.average(headline) for sheet in (record.sheet, linked.sheet)]
    return published_effect(effect, target.challenge, rounding, rows)


def published_effect(
    effect: ReminderEffect, challenge: Challenge, rounding: Rounding, rows: Sequence[MetricRow]
) -> ReminderEffect:
    """Round an effect, metrics in column order; only this result may leave the worker.

    `rows` are the published headlines with and without the reminder: as in a comparison, only their
    differences are published.
    """
    differences = {
        metric.key: rounded_difference(effect.differences[metric.key], metric, rows, rounding)
        for metric in challenge.interval_metrics
    }
    return effect.model_copy(update={"differences": differences})
