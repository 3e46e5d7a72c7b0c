"""Two entries by family and task: the difference of what is published, with its interval as a picture."""

from collections.abc import Mapping
from dataclasses import dataclass

from exceptiondrive_schemas.board import Board, BoardEntry, PairedComparison, PairedDifference
from exceptiondrive_schemas.challenges import Challenge, Metric
from exceptiondrive_schemas.protocol import Protocol
from exceptiondrive_schemas.score_sheet import Interval, ScoreSheet
from exceptiondrive_server.boards.scales import px
from exceptiondrive_server.entries.facts import challenge_of
from exceptiondrive_server.web.numbers import MINUS, Digits, unit_of

# Two entries compared sample by sample, as the board carries it, set for either order.


NOT_SEPARABLE = "not separable on this split"


@dataclass(frozen=True)
class PairedLine:
    """One metric or family: the difference of the first minus the second, as text."""

    label: str
    difference: str
    interval: str
    discordant: str
    verdict: str
    is_sure: bool


@dataclass(frozen=True)
class PairedTable:
    """Overall by metric, then families by the metric that ranks first."""

    overall: tuple[PairedLine, ...]
    families: tuple[PairedLine, ...]
    sentence: str


def paired_table(
    board: Board, a: str, b: str, challenge: Challenge, digits: Digits
) -> PairedTable | None:
    """Return the comparison of two submissions, or None where the board carries none."""
    found = find_pair(board, a, b)
    if found is None:
        return None
    first = challenge.metrics[0]
    overall = tuple(
        _paired_line(f"{m.label} {unit_of(m)}", m, found.overall[m.key], digits)
        for m in challenge.metrics
        if m.key in found.overall
    )
    return PairedTable(
        overall=overall,
        families=tuple(
            _paired_line(f"{head.title}, {first.label} {unit_of(first)}", first, each, digits)
            for head in board.families
            if (each := found.families.get(head.id)) is not None
        ),
        sentence=_sentence(board, first, overall[0], found.overall[first.key]),
    )


def find_pair(board: Board, a: str, b: str) -> PairedComparison | None:
    """Return the comparison of two submissions in this order, where the board carries one."""
    for pair in board.comparisons:
        if (pair.a, pair.b) == (a, b):
            return pair
        if (pair.a, pair.b) == (b, a):
            return _turned(pair)
    return None


def _turned(pair: PairedComparison) -> PairedComparison:
    return PairedComparison(
        a=pair.b,
        b=pair.a,
        overall={key: _negated(each) for key, each in pair.overall.items()},
        families={key: _negated(each) for key, each in pair.families.items()},
        tasks={key: _negated(each) for key, each in pair.tasks.items()},
    )


def _negated(found: PairedDifference) -> PairedDifference:
    """B minus A; the verdict names a method, so it stays."""
    interval = None if found.interval is None else (-found.interval[1], -found.interval[0])
    difference = None if found.difference is None else -found.difference
    return found.model_copy(update={"difference": difference, "interval": interval})


def _paired_line(label: str, metric: Metric, found: PairedDifference, digits: Digits) -> PairedLine:
    return PairedLine(
        label=label,
        difference="none" if found.difference is None else digits.signed(metric, found.difference),
        interval=_interval(metric, found, digits),
        discordant="" if found.discordant is None else f"{digits.fraction(found.discordant)} %",
        verdict=found.verdict,
        is_sure=found.verdict != NOT_SEPARABLE,
    )


def _interval(metric: Metric, found: PairedDifference, digits: Digits) -> str:
    if found.interval is None:
        return ""
    low, high = (digits.signed(metric, end) for end in found.interval)
    return f"{low} to {high}"


def _sentence(board: Board, first: Metric, line: PairedLine, found: PairedDifference) -> str:
    if found.interval is None:
        return f"Sample by sample, {first.label} gives no interval here."
    start = (
        f"Sample by sample, the difference in {first.label} is {line.interval} points "
        f"({board.confidence:.0%} interval): "
    )
    if line.is_sure:
        return f"{start}{line.verdict}."
    return f"{start}this split does not settle which is better."


HALF = 100.0
"""Half the width of a mark's drawing: zero stands in the middle."""
Sheets = tuple[ScoreSheet | None, ScoreSheet | None]


@dataclass(frozen=True)
class Mark:
    """A difference and its interval on the table's common axis, in SVG units."""

    at: str
    low: str | None
    width: str | None
    is_sure: bool


@dataclass(frozen=True)
class DifferenceLine:
    """One family or task."""

    title: str
    n: str
    is_family: bool
    difference: str
    interval: str
    verdict: str
    is_sure: bool
    mark: Mark | None


@dataclass(frozen=True)
class DifferenceTable:
    """Families, each followed by its tasks."""

    lines: tuple[DifferenceLine, ...]
    end: str
    """What the ends of the axis stand for, in points."""
    has_intervals: bool


@dataclass(frozen=True)
class _Raw:
    title: str
    n: int | None
    is_family: bool
    difference: float | None
    found: PairedDifference | None


def difference_table(
    board: Board,
    protocol: Protocol,
    pair: tuple[BoardEntry, BoardEntry],
    sheets: Sheets,
    found: PairedComparison | None,
    digits: Digits,
) -> DifferenceTable | None:
    """Set the first entry minus the second, by the metric that ranks first; None: nothing known.

    Args:
        board: The board that both stand on.
        protocol: Names the tasks.
        pair: Both entries.
        sheets: Their published score sheets, where they were scored here.
        found: Their comparison sample by sample in this order, where the board carries one.
        digits: Decimals of differences and of families' intervals; tasks' are in whole per cents.
    """
    metric = challenge_of(board).metrics[0]
    raws = [
        raw
        for head in board.families
        for raw in (
            _Raw(
                head.title,
                head.n,
                True,
                _between(*(_family(entry, head.id, metric) for entry in pair)),
                found.families.get(head.id) if found else None,
            ),
            *_tasks(protocol, head.id, metric, sheets, found.tasks if found else {}),
        )
    ]
    known = [raw for raw in raws if raw.difference is not None]
    if not known:
        return None
    end = _end(known)
    return DifferenceTable(
        lines=tuple(_line(raw, metric, digits, end) for raw in raws),
        end=f"{end * 100:.0f}",
        has_intervals=any(raw.found and raw.found.interval for raw in known),
    )


def _tasks(
    protocol: Protocol,
    family: str,
    metric: Metric,
    sheets: Sheets,
    found: Mapping[str, PairedDifference],
) -> list[_Raw]:
    lines = []
    for task in protocol.taxonomy.tasks_of(family):
        rows = [sheet.tasks.get(task.id) if sheet else None for sheet in sheets]
        values = [row.metrics.get(metric.key) if row else None for row in rows]
        n = next((row.n for row in rows if row and row.n), None)
        title = task.name.replace("_", " ").capitalize()
        if n:
            lines.append(_Raw(title, n, False, _between(*values), found.get(task.id)))
    return lines


def _family(entry: BoardEntry, family: str, metric: Metric) -> float | None:
    cell = entry.families.get(family)
    return None if cell is None else cell.metrics.get(metric.key)


def _between(a: float | None, b: float | None) -> float | None:
    return None if a is None or b is None else a - b


def _end(raws: list[_Raw]) -> float:
    """The largest distance from zero, rounded up to 5 points."""
    reach = [abs(raw.difference or 0.0) for raw in raws]
    reach += [
        abs(e) for raw in raws if raw.found and raw.found.interval for e in raw.found.interval
    ]
    return max(0.05, -(-max(reach) // 0.05) * 0.05)


def _line(raw: _Raw, metric: Metric, digits: Digits, end: float) -> DifferenceLine:
    found = raw.found
    interval = found.interval if found else None
    is_sure = found is not None and found.verdict != NOT_SEPARABLE
    return DifferenceLine(
        title=raw.title,
        n="" if raw.n is None else str(raw.n),
        is_family=raw.is_family,
        difference="none" if raw.difference is None else digits.signed(metric, raw.difference),
        interval=_interval_text(interval, metric, digits, is_fine=raw.is_family),
        verdict=found.verdict if found else "",
        is_sure=is_sure,
        mark=None if raw.difference is None else _mark(raw.difference, interval, end, is_sure),
    )


def _interval_text(
    interval: Interval | None, metric: Metric, digits: Digits, *, is_fine: bool
) -> str:
    if interval is None:
        return ""
    if is_fine:
        return " to ".join(digits.signed(metric, bound) for bound in interval)
    return " to ".join(_whole(bound) for bound in interval)


def _whole(bound: float) -> str:
    points = round(bound * 100)
    return f"{'+' if points > 0 else MINUS if points < 0 else ''}{abs(points)}"


def _mark(difference: float, interval: Interval | None, end: float, is_sure: bool) -> Mark:
    def at(value: float) -> float:
        return HALF + min(1.0, max(-1.0, value / end)) * (HALF - 4)

    low, high = interval or (None, None)
    return Mark(
        at=px(at(difference)),
        low=None if low is None else px(at(low)),
        width=None if low is None or high is None else px(at(high) - at(low)),
        is_sure=is_sure,
    )
