"""From scored entries to the rows of a board (docs/protocol.md section 4). Pure."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from exceptiondrive_records.boards.documents import Sharing
from exceptiondrive_records.boards.standings import EntryRecord
from exceptiondrive_schemas.board import BoardEntry, FamilyCell, FamilyHead
from exceptiondrive_schemas.challenges import Challenge
from exceptiondrive_schemas.coverage import unranked_flags, unranked_reasons
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.references import REFERENCES, TEAM, Reference
from exceptiondrive_schemas.score_sheet import Interval, ReminderEffect, ScoreSheet
from exceptiondrive_scoring.aliases import FloatArray
from exceptiondrive_scoring.bootstrap import Uncertainty
from exceptiondrive_scoring.rank import long_rank_intervals, ranks, told_rank_intervals
from exceptiondrive_worker.boards.rounding import Rounding
from exceptiondrive_worker.splits.store import LoadedSplit

_A_REFERENCE = "a reference, for comparison"


@dataclass(frozen=True)
class ScoredEntry:
    """An entry and the uncertainty of its metrics."""

    record: EntryRecord
    uncertainty: Uncertainty
    effect: ReminderEffect | None = None


@dataclass(frozen=True)
class ScoredReference:
    """A reference made by the worker: its published sheet and the uncertainty of its metrics."""

    reference: Reference
    sheet: ScoreSheet
    uncertainty: Uncertainty


def board_entries(
    entries: Sequence[ScoredEntry],
    made: Sequence[ScoredReference],
    challenge: Challenge,
    protocol: ProtocolDocument,
    rounding: Rounding,
) -> tuple[BoardEntry, ...]:
    """Return the rows of a board: ranked entries first, then references, those of teams last.

    Entries that take no rank because of their flags follow the ranked ones, in the order that they
    would have among them; then come those that cannot be ranked.
    """
    rows = _Rows(challenge, protocol, rounding)
    of_teams = [entry for entry in entries if not entry.record.is_reference]
    references = [entry for entry in entries if entry.record.is_reference]
    is_listed = [bool(unranked_flags(entry.record.sheet, protocol)) for entry in of_teams]
    places = rows.ranks(of_teams, [not listed for listed in is_listed])
    would_be = rows.ranks(of_teams, [True] * len(of_teams))
    by_rank = sorted((rank, number) for number, rank in enumerate(places) if rank is not None)
    ranked = [of_teams[number] for _, number in by_rank]
    spread = dict(
        zip([entry.record.submission_id for entry in ranked], rows.spread(ranked), strict=True)
    )
    scored = [
        (rows.scored(entry, rank, spread.get(entry.record.submission_id)), place)
        for entry, rank, place in zip(of_teams, places, would_be, strict=True)
    ]
    scored.sort(key=lambda it: (it[0].rank is None, it[1] is None, it[1] or 0, it[0].submitted_at))
    missing = set(REFERENCES.get(challenge.id, ())) - {each.reference for each in made}
    return (
        *(row for row, _ in scored),
        *(rows.made(each, missing) for each in made),
        *(rows.reference(entry) for entry in references),
    )


def family_heads(split: LoadedSplit, protocol: ProtocolDocument) -> tuple[FamilyHead, ...]:
    """Return the families that have samples on this split, in taxonomy order."""
    arrays, least = split.arrays, protocol.ranking.min_scenes
    heads = []
    for index, family in enumerate(protocol.families):
        scenes = arrays.scene_index[arrays.family_index == index]
        n_scenes = len(np.unique(scenes))
        told = n_scenes if n_scenes < least else None
        heads.append(FamilyHead(id=family.id, title=family.title, n=len(scenes), n_scenes=told))
    return tuple(head for head in heads if head.n)


class _Rows:
    """Builds the rows of one board; everything in them is rounded."""

    def __init__(
        self, challenge: Challenge, protocol: ProtocolDocument, rounding: Rounding
    ) -> None:
        self._challenge = challenge
        self._protocol = protocol
        self._average = protocol.grading.headline
        self._order = protocol.ranking.order_of(challenge)
        self._rounding = rounding
        self._sharing = Sharing()
        self._keys_of_intervals = [metric.key for metric in challenge.interval_metrics]

    def ranks(self, entries: Sequence[ScoredEntry], may_rank: Sequence[bool]) -> list[int | None]:
        """Rank the entries that may rank, by their published values; None for the others."""
        sheets = [entry.record.sheet for entry in entries]
        takes_part = [
            may and self._is_covered(sheet) for may, sheet in zip(may_rank, sheets, strict=True)
        ]
        return ranks([sheet.average(self._average) for sheet in sheets], takes_part, self._order)

    def spread(self, ranked: Sequence[ScoredEntry]) -> list[tuple[int, int] | None]:
        """Return the best and the worst possible rank of each entry, in the order of ranks.

        None if there are too few scenes. On a public split ranges come from the draws, else from
        the published intervals: exact draws compare two entries by single samples, as finely as an
        attacker likes.
        """
        first = self._order[0]
        index = self._keys_of_intervals.index(first.metric)
        ends = [entry.uncertainty.headline(self._average)[index] for entry in ranked]
        told = [
            None
            if np.isnan(each).any()
            else self._rounding.interval(first.metric, (float(each[0]), float(each[1])))
            for each in ends
        ]
        known = np.array([each or (-np.inf, np.inf) for each in told]).reshape(-1, 2)
        found = (
            long_rank_intervals(
                [entry.uncertainty for entry in ranked],
                known,
                first.order,
                self._protocol.ranking.confidence,
            )
            if self._rounding.is_public
            else told_rank_intervals(known, first.order)
        )
        return [
            None if np.isnan(interval).any() else (int(best), int(worst))
            for interval, (best, worst) in zip(ends, found, strict=True)
        ]

    def scored(
        self, entry: ScoredEntry, rank: int | None, spread: tuple[int, int] | None
    ) -> BoardEntry:
        row = self._row(entry)
        if rank is None:
            flags = unranked_flags(entry.record.sheet, self._protocol)
            why = self._why_unranked(entry.record.sheet)
            return row.model_copy(update={"unranked_because": why, "unranked_flags": flags})
        interval = None if spread is None else (min(spread[0], rank), max(spread[1], rank))
        return row.model_copy(update={"rank": rank, "rank_interval": interval})

    def reference(self, entry: ScoredEntry) -> BoardEntry:
        """Return the row of a team's entry that never ranks."""
        return self._row(entry).model_copy(
            update={"source": "reference", "unranked_because": _A_REFERENCE}
        )

    def made(self, made: ScoredReference, missing: Collection[Reference]) -> BoardEntry:
        """Return the row of a reference without a team; it names those the split cannot have."""
        description = made.reference.description
        if missing:
            names = " and ".join(sorted(each.method for each in missing))
            description += f" {names} would need recorded paths, which the split does not have."
        return BoardEntry(
            source="reference",
            rank=None,
            rank_interval=None,
            unranked_because=_A_REFERENCE,
            submission_id=None,
            method=made.reference.method,
            team=TEAM,
            description=description,
            submitted_at=None,
            **self._numbers(made.sheet, made.uncertainty),
        )

    def _row(self, entry: ScoredEntry) -> BoardEntry:
        record = entry.record
        return BoardEntry(
            source="scored",
            rank=None,
            rank_interval=None,
            submission_id=record.submission_id,
            method=record.method,
            team=record.team,
            description=record.description,
            links=record.links,
            submitted_at=record.submitted_at,
            reminder_effect=entry.effect,
            is_late=record.is_late,
            **self._numbers(record.sheet, entry.uncertainty),
        )

    def _numbers(self, sheet: ScoreSheet, sure: Uncertainty) -> dict[str, Any]:
        """Return the fields of a row that come from its sheet."""
        headline = sheet.average(self._average)
        return {
            "metrics": headline,
            "micro": sheet.micro,
            "macro_family": sheet.macro_family,
            "intervals": self._intervals(sure.headline(self._average), headline),
            "families": {
                family.id: self._family(sheet, family.id, sure.families[index])
                for index, family in enumerate(self._protocol.families)
                if family.id in sheet.families
            },
            "coverage": {"edited": sheet.coverage.edited, "source": sheet.coverage.source},
            "flags": sheet.plausibility.flags,
        }

    def _family(self, sheet: ScoreSheet, family_id: str, intervals: FloatArray) -> FamilyCell:
        cell = sheet.families[family_id]
        found = self._intervals(intervals, cell.metrics)
        row = FamilyCell.model_validate({**dict(cell), "intervals": found})
        self._sharing.share(row)
        return row

    def _intervals(
        self, intervals: FloatArray, values: Mapping[str, float | None]
    ) -> dict[str, Interval | None]:
        """Rounded intervals by metric; None where the metric itself is undefined or withheld."""
        return {
            key: None
            if values.get(key) is None or math.isnan(low) or math.isnan(high)
            else self._rounding.interval(key, (low, high))
            for key, (low, high) in zip(self._keys_of_intervals, intervals.tolist(), strict=True)
        }

    def _is_covered(self, sheet: ScoreSheet) -> bool:
        """Whether a file answers enough samples to be ranked, by the exact shares."""
        shares = sheet.coverage.exact_shares(sheet.n).values()
        return all(share >= self._protocol.ranking.min_coverage for share in shares)

    def _why_unranked(self, sheet: ScoreSheet) -> str:
        reasons = list(unranked_reasons(sheet, self._protocol))
        undefined = [
            self._challenge.metric(key.metric).label
            for key in self._order
            if sheet.average(self._average).get(key.metric) is None
        ]
        if undefined and self._is_covered(sheet):
            reasons.append(f"{' and '.join(undefined)} not defined")
        return "; ".join(reasons)
