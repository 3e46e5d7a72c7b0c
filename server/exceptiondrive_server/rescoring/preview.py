"""Every entry before and after a run, worst movers first."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_schemas.api.rescoring import Comparison, EntryChange, Standing
from exceptiondrive_schemas.api.standing_words import other_changes
from exceptiondrive_schemas.challenges import CHALLENGES, Metric
from exceptiondrive_schemas.printable import counted
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_server.web.numbers import Digits, px
from exceptiondrive_server.web.templating import template_filter

SHOWN = 40
"""Entries on a page: it stays small, and the file has them all."""
MOST_LINES = 24
ROW = 26.0
TOP = 44.0
NOT_RANKED = "–"
LAST = 1_000_000
"""Stands for the rank of who has none."""
_DULL = 1e-9


@dataclass(frozen=True)
class SlopeLine:
    """One entry; `kind` is up, down, same, gone or new."""

    kind: str
    y1: str
    y2: str
    name: str
    before: str
    after: str
    title: str


@dataclass(frozen=True)
class SlopeChart:
    """The drawing."""

    width: int
    height: int
    x1: int
    x2: int
    left_title: str
    right_title: str
    lines: tuple[SlopeLine, ...]
    n_left_out: int
    description: str


@dataclass(frozen=True)
class Shift:
    """A number before and after; `tone` is better, worse or same."""

    old: str | None
    new: str | None
    difference: str | None
    tone: str


@dataclass(frozen=True)
class Shifts:
    """Sets the numbers of entries; `protocol` is the one to come, whose digits are published."""

    protocol: ProtocolDocument
    comparison: Comparison

    @property
    def metrics(self) -> tuple[Metric, ...]:
        """The primary metrics; families show the first."""
        return CHALLENGES[self.comparison.challenge].metrics[:2]

    @cached_property
    def families(self) -> dict[str, str]:
        """Title of each family that an entry has numbers of."""
        sides = [side for one in self.comparison.entries for side in (one.old, one.new) if side]
        there = {family for side in sides for family in side.families}
        return {one.id: one.title for one in self.protocol.families if one.id in there}

    def of_metrics(self, one: EntryChange) -> list[Shift]:
        """Return the primary metrics of an entry."""
        old, new = (side.metrics if side else {} for side in (one.old, one.new))
        return [
            self._shift(metric, old.get(metric.key), new.get(metric.key)) for metric in self.metrics
        ]

    def of_families(self, one: EntryChange) -> list[Shift]:
        """Return the first metric of an entry in each family."""
        metric = self.metrics[0]
        old, new = (side.families if side else {} for side in (one.old, one.new))
        return [
            self._shift(metric, old.get(key, {}).get(metric.key), new.get(key, {}).get(metric.key))
            for key in self.families
        ]

    def elsewhere(self, one: EntryChange) -> str:
        """Say which numbers change where no column does; else nothing."""
        if one.change != "numbers" or one.old is None or one.new is None:
            return ""
        if any(cell.old != cell.new for cell in (*self.of_metrics(one), *self.of_families(one))):
            return ""
        challenge, digits = CHALLENGES[self.comparison.challenge], self.protocol.publication
        return ", ".join(other_changes(challenge, one.old, one.new, digits))

    def _shift(self, metric: Metric, old: float | None, new: float | None) -> Shift:
        digits = Digits.of(self.protocol.publication)
        texts = digits.text(metric, old), digits.text(metric, new)
        if old is None or new is None or abs(new - old) < _DULL:
            return Shift(*texts, None, "same")
        is_better = (new > old) == (metric.better == "higher")
        return Shift(*texts, digits.signed(metric, new - old), "better" if is_better else "worse")


def compared(
    comparison: Comparison, protocol: ProtocolDocument, page: int, phase: Phase
) -> dict[str, Any]:
    """Return what fills `compared.html`; `protocol` is the one to come, a page beyond the last is the last."""
    ordered = worst_first(comparison)
    n_pages = max(1, -(-len(ordered) // SHOWN))
    number = min(page, n_pages)
    return {
        "c": comparison,
        "has_late_view": phase.policy.late_entries == "own_view",
        "shown": ordered[(number - 1) * SHOWN : number * SHOWN],
        "shifts": Shifts(protocol, comparison),
        "number": number,
        "n_pages": n_pages,
        "wide": slope_chart(comparison, width=860, longest=28),
        "narrow": slope_chart(comparison, width=420, longest=15),
    }


def worst_first(comparison: Comparison) -> list[EntryChange]:
    """Return worst movers first, then what changes, then the rest as the new board has it."""
    worst = {key: place for place, key in enumerate(comparison.worst_movers)}

    def order(one: EntryChange) -> tuple[int, bool, int]:
        place = worst.get(one.submission_id, len(worst))
        return (place, one.change == "none", one.new_rank or LAST)

    return sorted(comparison.entries, key=order)


@template_filter
def rank_words(standing: Standing | None) -> str:
    """Return the rank of an entry on one board, with its interval."""
    if standing is None:
        return "not there"
    if standing.rank is None:
        return "not ranked"
    if standing.rank_interval is None or standing.rank_interval[0] == standing.rank_interval[1]:
        return str(standing.rank)
    low, high = standing.rank_interval
    return f"{standing.rank} ({low} to {high})"


def slope_chart(comparison: Comparison, *, width: int, longest: int) -> SlopeChart | None:
    """Return old rank to new rank, a line per entry; None when none is ranked on either board.

    Of a long board those entries are drawn that move most; the table beside it has them all. Beside
    the lines a name has room for `longest` characters.
    """
    ranked = [one for one in comparison.entries if one.old_rank or one.new_rank]
    worst = {submission_id: place for place, submission_id in enumerate(comparison.worst_movers)}

    def importance(one: EntryChange) -> tuple[bool, int, int, int]:
        place = worst.get(one.submission_id, len(worst))
        return (not one.newly_failing, -abs(one.rank_shift or 0), place, one.new_rank or LAST)

    drawn = sorted(ranked, key=importance)[:MOST_LINES]
    if not drawn:
        return None
    left = _rows(drawn, [one.old_rank for one in drawn])
    right = _rows(drawn, [one.new_rank for one in drawn])
    margin = round(longest * 7.6 + 42)
    changed = counted(comparison.n_ranks_changed, "rank changes", "ranks change")
    is_update = comparison.from_protocol != comparison.to_protocol
    return SlopeChart(
        width=width,
        height=round(TOP + len(drawn) * ROW + 4),
        x1=margin,
        x2=width - margin,
        left_title=f"under {comparison.from_protocol.version}"
        if is_update
        else "old split revision",
        right_title=f"under {comparison.to_protocol.version}"
        if is_update
        else "new split revision",
        lines=tuple(
            _slope_line(one, left[one.submission_id], right[one.submission_id], longest)
            for one in drawn
        ),
        n_left_out=len(ranked) - len(drawn),
        description=f"Old rank to new rank of {counted(len(drawn), 'entry', 'entries')}; "
        f"{changed} in all.",
    )


def _rows(drawn: Sequence[EntryChange], ranks: Sequence[int | None]) -> dict[str, float]:
    """Rows by rank; ties keep rows of their own so that no two names cover each other."""
    named = zip(ranks, drawn, strict=True)
    order = sorted((rank or LAST, one.method, one.submission_id) for rank, one in named)
    return {submission_id: TOP + (row + 0.5) * ROW for row, (*_, submission_id) in enumerate(order)}


def _slope_line(one: EntryChange, y1: float, y2: float, longest: int) -> SlopeLine:
    old, new = one.old_rank, one.new_rank
    if new is None:
        kind = "gone"
    elif old is None:
        kind = "new"
    else:
        kind = "same" if old == new else "up" if new < old else "down"
    name = one.method if len(one.method) <= longest else f"{one.method[: longest - 1]}…"
    before, after = ("not ranked" if rank is None else f"rank {rank}" for rank in (old, new))
    return SlopeLine(
        kind=kind,
        y1=px(y1),
        y2=px(y2),
        name=name,
        before=str(old or NOT_RANKED),
        after=str(new or NOT_RANKED),
        title=f"{one.method} of {one.team}: {before} before, {after} after",
    )
