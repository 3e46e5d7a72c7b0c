"""Two entries of one board side by side: a plain verdict, their families, differences."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from exceptiondrive_schemas.board import Board, BoardEntry, PairedComparison
from exceptiondrive_schemas.challenges import Challenge, Metric
from exceptiondrive_schemas.printable import MINUS, counted
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.score_sheet import Interval, PairedDifference, ScoreSheet
from exceptiondrive_server.boards.charts import labels_of
from exceptiondrive_server.boards.entry_facts import (
    challenge_of,
    entry_key,
    flags_of,
    is_barred,
    why_no_intervals,
)
from exceptiondrive_server.boards.table import short_title
from exceptiondrive_server.web.numbers import Digits, listed, percent, unit_of
from exceptiondrive_server.web.templating import template_filter

MAX_COMPARED = 6
LONGEST_NAME = 200
"""A method with its team, uncut."""
Sheets = tuple[ScoreSheet | None, ScoreSheet | None]


@dataclass(frozen=True)
class Comparison:
    """Two entries of one board under its headline average; differences are first minus second."""

    board: Board
    a: BoardEntry
    b: BoardEntry
    digits: Digits
    among: Sequence[BoardEntry] = ()
    """All that a page sets side by side, these two first; none: the two alone."""

    @cached_property
    def challenge(self) -> Challenge:
        """The challenge of the board."""
        return challenge_of(self.board)

    @property
    def first(self) -> Metric:
        """The first metric of the challenge, by which families and tasks are compared."""
        return self.challenge.metrics[0]

    @property
    def a_key(self) -> str:
        """Name of the first entry in addresses."""
        return entry_key(self.a)

    @property
    def b_key(self) -> str:
        """Name of the second entry in addresses."""
        return entry_key(self.b)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """What the two are called beside each other."""
        return labels_of(self.among or (self.a, self.b), LONGEST_NAME)[:2]

    @cached_property
    def paired(self) -> PairedComparison | None:
        """The comparison sample by sample, where the board carries one."""
        return find_pair(self.board, self.a_key, self.b_key)

    def difference(self, metric: Metric) -> str:
        """Write first minus second: sample by sample where that is known, else of the two values."""
        found = self.paired.overall.get(metric.key) if self.paired else None
        if found is not None and found.difference is not None:
            return self.digits.signed(metric, found.difference)
        return self.digits.difference(
            metric, self.a.metrics.get(metric.key), self.b.metrics.get(metric.key)
        )

    def better(self, metric: Metric) -> str:
        """Return `a` or `b`, whichever has the better value; nothing where none has."""
        x, y = self.a.metrics.get(metric.key), self.b.metrics.get(metric.key)
        if x is None or y is None or x == y or not metric.better:
            return ""
        return "a" if (x > y) == (metric.better == "higher") else "b"

    def marked(self, metric: Metric) -> str:
        """Return which is marked as the better one: none that a flag bars from leading."""
        better = self.better(metric)
        return "" if better and is_barred({"a": self.a, "b": self.b}[better]) else better

    @cached_property
    def verdict(self) -> str:
        """Which entry is ahead, in plain words, and whether the data can tell."""
        first, digits = self.first, self.digits
        x, y = self.a.metrics.get(first.key), self.b.metrics.get(first.key)
        if x is None or y is None:
            missing = self.names[x is not None]
            return f"{missing} has no {first.label}, so the two cannot be compared."
        if digits.text(first, x) == digits.text(first, y):
            return f"Both stand at {digits.text(first, x)} {unit_of(first)} {first.label}."
        named = tuple(zip((self.a, self.b), self.names, strict=True))
        (ahead, winner), (behind, loser) = named if self.better(first) == "a" else named[::-1]
        gap = self.difference(first).lstrip(f"+{MINUS}")
        lead = f"{first.label}: {winner} is {gap} points better than {loser}."
        found = self.paired.overall[first.key] if self.paired else None
        sure = self._sentence(found) if found else _certainty(ahead, behind, first)
        return " ".join([lead, sure, *flagged(((ahead, winner), (behind, loser)))])

    def settled(self, metric: Metric, found: PairedDifference) -> str:
        """The verdict of a comparison sample by sample, in which a board names methods alone."""
        side = side_of(found)
        if not side:
            return found.verdict
        is_first = (side > 0) == (metric.better != "lower")
        _, _, what = found.verdict.rpartition(" is ")
        return f"{self.names[not is_first]} is {what}"

    def _sentence(self, found: PairedDifference) -> str:
        """What the comparison sample by sample says."""
        label = self.first.label
        if found.interval is None:
            return f"Sample by sample, {label} gives no interval here. {why_no_intervals(self.board)}".rstrip()
        is_open = "this split does not settle which is better"
        settled = self.settled(self.first, found) if is_sure(found) else is_open
        return (
            f"Sample by sample, the difference in {label} is "
            f"{self.digits.interval(self.first, found.interval, signed=True)} points "
            f"({percent(self.board.confidence)} interval): {settled}."
        )

    @cached_property
    def families_sentence(self) -> str:
        """The families in which one is surely ahead, sample by sample, and how many stay open.

        Of those that have an interval: a family of few samples or scenes has none. Empty where none has.
        """
        if self.paired is None:
            return ""
        found = [
            (each, short_title(head.title).lower())
            for head in self.board.families
            if (each := self.paired.families.get(head.id)) is not None and each.interval
        ]
        sign = 1 if self.first.better == "higher" else -1
        parts = []
        for called, side in zip(self.names, (sign, -sign), strict=True):
            names = [name for each, name in found if side_of(each) == side]
            if names:
                parts.append(f"{called} is ahead in {listed(names)} scenes")
        n_open = sum([side_of(each) == 0 for each, _ in found])
        if n_open:
            parts.append(
                "in no family is one surely ahead"
                if n_open == len(found)
                else f"in {counted(n_open, 'family', 'families')} the split does not tell them apart"
            )
        words = "; ".join(parts)
        return f"{words[:1].upper()}{words[1:]}." if words else ""


def default_pair(board: Board) -> tuple[BoardEntry, BoardEntry] | None:
    """Return the leader and the next ranked entry; None if fewer than two are ranked."""
    ranked = sorted((e for e in board.entries if e.rank is not None), key=lambda e: e.rank or 0)
    first = board.leader or next(iter(ranked), None)
    others = [e for e in ranked if e is not first]
    others.sort(key=lambda e: not e.may_lead)
    return (first, others[0]) if first and others else None


def find_pair(board: Board, a: str, b: str) -> PairedComparison | None:
    """Return the comparison of two submissions in this order, if the board has one."""
    for pair in board.comparisons:
        if (pair.a, pair.b) == (a, b):
            return pair
        if (pair.a, pair.b) == (b, a):
            parts = {
                name: {key: _negated(found) for key, found in getattr(pair, name).items()}
                for name in ("overall", "families", "tasks")
            }
            return pair.model_copy(update={"a": a, "b": b, **parts})
    return None


def _negated(found: PairedDifference) -> PairedDifference:
    """B minus A; the verdict names a method, so it stays."""
    interval = None if found.interval is None else (-found.interval[1], -found.interval[0])
    difference = None if found.difference is None else -found.difference
    return found.model_copy(update={"difference": difference, "interval": interval})


@template_filter
def is_sure(found: PairedDifference | None) -> bool:
    """Whether a paired comparison settles which is better."""
    return side_of(found) != 0


def side_of(found: PairedDifference | None) -> int:
    """Return 1 or -1 if the whole interval is on that side of zero, else 0."""
    if found is None or found.interval is None:
        return 0
    low, high = found.interval
    return (low > 0) - (high < 0)


@template_filter
def family_value(entry: BoardEntry, family: str, metric: Metric) -> float | None:
    """Return a metric of one family; None where it is unknown."""
    cell = entry.families.get(family)
    return None if cell is None else cell.metrics.get(metric.key)


def flagged(entries: Iterable[tuple[BoardEntry, str]]) -> list[str]:
    """Name the flags of some entries under what these are called, a sentence each."""
    return [f"{called} is flagged: {flags_of(entry)}." for entry, called in entries if entry.flags]


def _overlap(one: Interval, two: Interval) -> bool:
    return one[0] <= two[1] and two[0] <= one[1]


_NOT_PAIRED = "these two were not compared sample by sample, which could still settle it"


def _certainty(ahead: BoardEntry, behind: BoardEntry, metric: Metric) -> str:
    """What rank intervals, else intervals, say of two that were not compared sample by sample."""
    if ahead.rank_interval and behind.rank_interval:
        if not _overlap(ahead.rank_interval, behind.rank_interval):
            return "The ranks that each could have do not overlap."
        return f"The ranks that each could have overlap; {_NOT_PAIRED}."
    one, two = ahead.intervals.get(metric.key), behind.intervals.get(metric.key)
    if one is None or two is None:
        return "Without intervals for both, this board does not say whether the order is sure."
    if not _overlap(one, two):
        return "Their intervals do not overlap."
    return f"Their intervals overlap; {_NOT_PAIRED}."


@dataclass(frozen=True)
class Difference:
    """One family or task: the first entry minus the second, and what is known sample by sample."""

    title: str
    n: int | None
    is_family: bool
    value: float | None
    found: PairedDifference | None

    def interval(self, metric: Metric, digits: Digits) -> str:
        """Write the interval; that of a task ends at whole per cents, outward."""
        digits = digits if self.is_family else replace(digits, has_fine_intervals=False)
        return digits.interval(metric, self.found.interval if self.found else None, signed=True)


@dataclass(frozen=True)
class DifferenceTable:
    """Families, each followed by its tasks, on one axis around zero."""

    lines: tuple[Difference, ...]
    end: float
    """What the ends of the axis stand for."""

    @property
    def has_intervals(self) -> bool:
        """Whether any line was compared sample by sample."""
        return any(
            line.found and line.found.interval for line in self.lines if line.value is not None
        )

    def at(self, value: float) -> float:
        """Return the place of a difference on an axis of 200 units, zero in the middle."""
        return 100 + min(1.0, max(-1.0, value / self.end)) * 96


def difference_table(
    both: Comparison, protocol: ProtocolDocument, sheets: Sheets
) -> DifferenceTable | None:
    """Return the differences in the first metric; None where nothing is known."""
    lines = tuple(_differences(both, protocol, sheets))
    known = [line for line in lines if line.value is not None]
    if not known:
        return None
    reach = [abs(line.value or 0.0) for line in known]
    reach += [abs(end) for line in known if line.found for end in line.found.interval or ()]
    return DifferenceTable(lines, max(0.05, -(-max(reach) // 0.05) * 0.05))  # to whole 5 points


def _differences(
    both: Comparison, protocol: ProtocolDocument, sheets: Sheets
) -> Iterator[Difference]:
    key = both.first.key
    families, tasks = (both.paired.families, both.paired.tasks) if both.paired else ({}, {})
    for head in both.board.families:
        x, y = (family_value(entry, head.id, both.first) for entry in (both.a, both.b))
        value = None if x is None or y is None else x - y
        yield Difference(head.title, head.n, True, value, families.get(head.id))
        for task in protocol.taxonomy.tasks_of(head.id):
            rows = [sheet.tasks.get(task.id) if sheet else None for sheet in sheets]
            x, y = (row.metrics.get(key) if row else None for row in rows)
            n = next((row.n for row in rows if row and row.n), None)
            if n:
                value = None if x is None or y is None else x - y
                yield Difference(task.title, n, False, value, tasks.get(task.id))
