"""Intervals of entries, and paired comparisons of the best ones, sample by sample.

Intervals are computed once per entry and cached: a new entry costs only its own. The draws come
from the protocol's seed alone, so results computed for one board serve the next.

Sample scores are withheld: they are compared here, and only rounded differences leave. A comparison
is cached under the hash of its inputs, so a new entry on the board repeats none.
"""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from itertools import combinations, islice
from typing import Any

import numpy as np

from exceptiondrive_records.boards.standings import EntryRecord
from exceptiondrive_schemas.base import canonical_json
from exceptiondrive_schemas.board import BoardEntry, PairedComparison
from exceptiondrive_schemas.challenges import Challenge, Metric
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.score_sheet import MetricRow, PairedDifference, ScoreSheet
from exceptiondrive_scoring.aliases import Columns
from exceptiondrive_scoring.bootstrap import Uncertainty, bootstrap
from exceptiondrive_scoring.compare import NO_INTERVAL, NOT_SEPARABLE, compare
from exceptiondrive_worker.boards.rounding import Rounding
from exceptiondrive_worker.splits.private_store import PrivateStore, Shelf, content_key
from exceptiondrive_worker.stages import Stages, Target

Standing = tuple[Target, EntryRecord]


def best_ranked(entries: Sequence[BoardEntry], protocol: ProtocolDocument) -> list[str]:
    """Return the submissions that are compared, in order; ranked rows come first and in order."""
    ranked = (row.submission_id for row in entries if row.rank is not None and row.submission_id)
    return list(islice(ranked, protocol.publication.compared_entries))


def comparisons(
    stages: Stages,
    best: Sequence[Standing],
    protocol: ProtocolDocument,
    rounding: Rounding,
) -> tuple[PairedComparison, ...]:
    """Compare each pair of the best ranked entries, the better ranked first; rounded.

    On a withheld split two entries of one team are not compared: for two files that differ in one
    sample, the interval would be that sample's value. The records have their whole sheets.
    """
    return tuple(
        published_comparison(
            _named(kept_comparison(stages, a, b), a[1], b[1]),
            a[0].challenge,
            protocol,
            (a[1].sheet, b[1].sheet),
            rounding,
        )
        for a, b in combinations(best, 2)
        if rounding.is_public or a[1].team_slug != b[1].team_slug
    )


def kept_comparison(stages: Stages, a: Standing, b: Standing) -> PairedComparison:
    """Return the comparison of two entries, called A and B, cached if possible; unrounded."""
    target = a[0]
    key = content_key(
        "comparison/5",
        *(stages.scene_sums_key(each, record.measurement_key) for each, record in (a, b)),
        target.protocol.ranking_digest,
        target.protocol.grading.headline,
    )
    kept = stages.private.read_document(Shelf.COMPARISONS, key, PairedComparison)
    if kept is not None:
        return kept
    of_a, of_b = (stages.sample_scores(each, record.measurement_key) for each, record in (a, b))
    made = compare(of_a, of_b, target.split.arrays, target.protocol, target.challenge)
    stages.private.write(Shelf.COMPARISONS, key, canonical_json(made))
    return made


def _named(found: PairedComparison, a: EntryRecord, b: EntryRecord) -> PairedComparison:
    """Replace A and B by the submissions, and in verdicts by the methods."""
    methods = {"A": a.method, "B": b.method}

    def words(verdict: str) -> str:
        who, _, what = verdict.partition(" is ")
        return f"{methods[who]} is {what}" if who in methods else verdict

    def named(rows: Mapping[str, PairedDifference]) -> dict[str, PairedDifference]:
        return {
            key: row.model_copy(update={"verdict": words(row.verdict)}) for key, row in rows.items()
        }

    return PairedComparison(
        a=a.submission_id,
        b=b.submission_id,
        overall=named(found.overall),
        families=named(found.families),
        tasks=named(found.tasks),
    )


def published_comparison(
    exact: PairedComparison,
    challenge: Challenge,
    protocol: ProtocolDocument,
    sheets: tuple[ScoreSheet, ScoreSheet],
    rounding: Rounding,
) -> PairedComparison:
    """Round a comparison, metrics in column order; only this result may leave the worker.

    Families and tasks with fewer samples than the protocol publishes are left out. A difference is
    taken between the published values of the sheets: rounded on its own, each would be one more
    reading of the exact values (docs/leakage.md). A shift or progress may be undefined, does not
    depend on regions, and is compared where both define it. How
    many samples differ is published for public splits only: it counts differences below rounding.
    """
    first = challenge.metrics[0].key
    headlines = [sheet.average(protocol.grading.headline) for sheet in sheets]

    def cells(group: str, key: str) -> list[MetricRow]:
        return [getattr(sheet, group)[key].metrics for sheet in sheets]

    return exact.model_copy(
        update={
            "overall": {
                metric.key: rounded_difference(
                    exact.overall[metric.key], metric, headlines, rounding
                )
                for metric in challenge.interval_metrics
            },
            "families": {
                family.id: rounded_difference(
                    exact.families[family.id],
                    challenge.metric(first),
                    cells("families", family.id),
                    rounding,
                )
                for family in protocol.families
                if _is_shown(sheets, "families", family.id, protocol)
            },
            "tasks": {
                task.id: _coarse_difference(
                    exact.tasks[task.id], first, cells("tasks", task.id), rounding
                )
                for task in protocol.tasks
                if _is_shown(sheets, "tasks", task.id, protocol)
            },
        }
    )


def _is_shown(
    sheets: tuple[ScoreSheet, ScoreSheet], group: str, key: str, protocol: ProtocolDocument
) -> bool:
    rows = [getattr(sheet, group).get(key) for sheet in sheets]
    least = protocol.publication.min_samples_per_cell
    return all(row is not None and (row.n or 0) >= least for row in rows)


def rounded_difference(
    exact: PairedDifference, metric: Metric, rows: Sequence[MetricRow], rounding: Rounding
) -> PairedDifference:
    """Round a difference between two published rows, first minus second.

    For a metric that may be undefined, it is the difference over the samples that both define.
    """
    if metric.may_be_undefined:
        difference = rounding.metric(metric.key, exact.difference)
    else:
        difference = _cell_difference(metric.key, rows, rounding)
    interval = rounding.interval(metric.key, exact.interval)
    return exact.model_copy(
        update={
            "difference": difference,
            "interval": interval,
            "discordant": rounding.fraction(exact.discordant) if rounding.is_public else None,
            "verdict": published_verdict(exact, interval),
        }
    )


def _coarse_difference(
    exact: PairedDifference, key: str, rows: Sequence[MetricRow], rounding: Rounding
) -> PairedDifference:
    """Return a task's difference: few samples, so nothing finer than the two published cells."""
    interval = rounding.coarse_interval(exact.interval)
    return PairedDifference(
        difference=_cell_difference(key, rows, rounding),
        interval=interval,
        discordant=None,
        verdict=published_verdict(exact, interval),
    )


def _cell_difference(key: str, rows: Sequence[MetricRow], rounding: Rounding) -> float | None:
    a, b = (row.get(key) for row in rows)
    return None if a is None or b is None else rounding.metric(key, a - b)


def published_verdict(exact: PairedDifference, interval: tuple[float, float] | None) -> str:
    """Return the exact verdict, unless the published interval no longer shows it."""
    if interval is None:
        return NO_INTERVAL
    return NOT_SEPARABLE if interval[0] <= 0 <= interval[1] else exact.verdict


_FIELDS = fields(Uncertainty)


def entry_uncertainties(stages: Stages, entries: Sequence[tuple[Target, str]]) -> list[Uncertainty]:
    """Return the intervals of a board's entries, in order; each is a target and measurement key."""
    keys = [_key(stages, target, measurement_key) for target, measurement_key in entries]
    kept = {key: _kept_uncertainty(stages.private, key) for key in keys}
    found = {key: uncertainty for key, uncertainty in kept.items() if uncertainty is not None}
    missing = {key: entry for key, entry in zip(keys, entries, strict=True) if kept[key] is None}
    if missing:
        protocol, challenge = entries[0][0].protocol, entries[0][0].challenge
        sums = (stages.scene_sums(*entry) for entry in missing.values())
        computed = bootstrap(sums, challenge, protocol.ranking, protocol.grading.headline)
        # each is cached at once: a build that is interrupted continues from there
        for key, uncertainty in zip(missing, computed, strict=True):
            stages.private.write_columns(Shelf.INTERVALS, key, _columns(uncertainty))
            found[key] = uncertainty
    return [found[key] for key in keys]


def _key(stages: Stages, target: Target, measurement_key: str) -> str:
    protocol = target.protocol
    return content_key(
        "intervals",
        stages.scene_sums_key(target, measurement_key),
        protocol.ranking_digest,
        protocol.grading.headline,
    )


def _columns(uncertainty: Uncertainty) -> Columns:
    """Return every field as an array; a plain number has no axes."""
    return {field.name: np.asarray(getattr(uncertainty, field.name)) for field in _FIELDS}


def _kept_uncertainty(private: PrivateStore, key: str) -> Uncertainty | None:
    columns = private.read_columns(Shelf.INTERVALS, key)
    if columns is None or columns.keys() != {field.name for field in _FIELDS}:
        return None
    values: dict[str, Any] = {
        name: column if column.ndim else column.item() for name, column in columns.items()
    }
    return Uncertainty(**values)
