"""Two entries by family and task: the difference of what is published, with its interval as a picture."""

from collections.abc import Mapping
from dataclasses import dataclass

from exceptiondrive_schemas.board import Board, BoardEntry, PairedComparison, PairedDifference
from exceptiondrive_schemas.challenges import Metric
from exceptiondrive_schemas.protocol import Protocol
from exceptiondrive_schemas.score_sheet import Interval, ScoreSheet
from exceptiondrive_server.pages.entry_facts import challenge_of
from exceptiondrive_server.pages.numbers import MINUS, Digits
from exceptiondrive_server.pages.paired_table import NOT_SEPARABLE
from exceptiondrive_server.pages.scales import px

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
