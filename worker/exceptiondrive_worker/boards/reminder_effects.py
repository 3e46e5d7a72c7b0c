"""What a reminder changed: an entry against its linked counterpart, sample by sample.

Sample scores are withheld: they are compared here, and only rounded differences leave. A comparison
is kept under the hash of what made it, so a new entry on the board repeats none.
"""

from collections.abc import Sequence

from exceptiondrive_records.boards.standings import EntryRecord
from exceptiondrive_schemas.base import canonical_json
from exceptiondrive_schemas.challenges import Challenge
from exceptiondrive_schemas.score_sheet import MetricRow, ReminderEffect
from exceptiondrive_scoring.compare import Comparison, compare
from exceptiondrive_worker.boards.comparisons import (
    Standing,
    paired_difference,
    rounded_difference,
)
from exceptiondrive_worker.boards.rounding import Rounding
from exceptiondrive_worker.splits.private_store import Shelf, content_key
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

    None where it is linked to no entry of the board, or to one that has reminder records of its own.
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
    (target, record), (other, linked) = with_it, without_it
    key = content_key(
        "effect/3",
        stages.scene_sums_key(target, record.measurement_key),
        stages.scene_sums_key(other, linked.measurement_key),
        target.protocol.ranking_digest,
        target.protocol.grading.headline,
        linked.submission_id,
        linked.method,
    )
    effect = stages.private.read_document(Shelf.EFFECTS, key, ReminderEffect)
    if effect is None:
        compared = compare(
            stages.sample_scores(target, record.measurement_key),
            stages.sample_scores(other, linked.measurement_key),
            target.split.arrays,
            target.protocol,
            target.challenge,
        )
        effect = exact_effect(compared, linked)
        stages.private.write(Shelf.EFFECTS, key, canonical_json(effect))
    headline = target.protocol.grading.headline
    rows = [sheet.average(headline) for sheet in (record.sheet, linked.sheet)]
    return published_effect(effect, target.challenge, rounding, rows)


def exact_effect(compared: Comparison, linked: EntryRecord) -> ReminderEffect:
    """Put a comparison of an entry (A) with its counterpart (B) in the words of a board."""
    return ReminderEffect(
        without=linked.submission_id,
        without_method=linked.method,
        differences={
            key: paired_difference(found, _VERDICTS.get(found.verdict, found.verdict))
            for key, found in compared.overall.items()
        },
    )


def published_effect(
    effect: ReminderEffect, challenge: Challenge, rounding: Rounding, rows: Sequence[MetricRow]
) -> ReminderEffect:
    """Round an effect, metrics in column order; only this may leave the worker.

    `rows` are the published headlines with the reminder and without it: their differences are told, as
    in a comparison, and nothing more.
    """
    differences = {
        metric.key: rounded_difference(effect.differences[metric.key], metric, rows, rounding)
        for metric in challenge.interval_metrics
    }
    return effect.model_copy(update={"differences": differences})
