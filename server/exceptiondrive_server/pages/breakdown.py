"""Families and tasks of one entry: numbers and outcome bars, ready to be set."""

from collections.abc import Mapping
from dataclasses import dataclass

from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.challenges import Challenge
from exceptiondrive_schemas.protocol import Protocol
from exceptiondrive_schemas.score_sheet import BreakdownRow, Interval, ScoreSheet
from exceptiondrive_server.pages.entry_facts import challenge_of, outcome_parts
from exceptiondrive_server.pages.family_tiles import SMALL_FAMILY
from exceptiondrive_server.pages.numbers import Digits


@dataclass(frozen=True)
class Bar:
    """Outcome bar with the interval of the first metric, in per cent of the width."""

    kept: float
    lost: float
    hit: float
    low: float | None
    high: float | None


@dataclass(frozen=True)
class BreakdownLine:
    """One family or task."""

    id: str
    title: str
    detail: str
    n: int | None
    is_small: bool
    is_family: bool
    values: tuple[str | None, ...]
    bar: Bar | None
    words: str


def breakdown_lines(
    board: Board, entry: BoardEntry, sheet: ScoreSheet | None, protocol: Protocol, digits: Digits
) -> tuple[BreakdownLine, ...]:
    """Return each family of an entry, followed by its tasks where a score sheet is known."""
    challenge = challenge_of(board)
    tasks: Mapping[str, BreakdownRow] = sheet.tasks if sheet else {}
    lines: list[BreakdownLine] = []
    for head in board.families:
        cell = entry.families.get(head.id)
        if cell is None:
            continue
        interval = cell.intervals.get(challenge.metrics[0].key)
        lines.append(_line(head.id, head.title, "", cell, challenge, digits, interval, True))
        lines += [
            _line(task.id, _title(task.name), task.hazard, tasks[task.id], challenge, digits)
            for task in protocol.taxonomy.tasks_of(head.id)
            if task.id in tasks
        ]
    return tuple(lines)


def _title(name: str) -> str:
    return name.replace("_", " ").capitalize()


def _line(
    key: str,
    title: str,
    detail: str,
    row: BreakdownRow,
    challenge: Challenge,
    digits: Digits,
    interval: Interval | None = None,
    is_family: bool = False,
) -> BreakdownLine:
    values = tuple(digits.text(m, row.metrics.get(m.key)) for m in challenge.metrics)
    named = zip(challenge.metrics, values, strict=True)
    words = ", ".join(f"{metric.label} {text}" for metric, text in named if text is not None)
    return BreakdownLine(
        id=key,
        title=title,
        detail=detail,
        n=row.n,
        is_small=row.n is not None and row.n < SMALL_FAMILY,
        is_family=is_family,
        values=values,
        bar=_bar(challenge, row, interval),
        words=f"{title}: {words or 'no score'}",
    )


def _bar(challenge: Challenge, row: BreakdownRow, interval: Interval | None) -> Bar | None:
    parts = outcome_parts(challenge, row.metrics)
    low, high = (interval[0] * 100, interval[1] * 100) if interval else (None, None)
    if parts is None:
        first = row.metrics.get(challenge.metrics[0].key)
        return None if first is None else Bar(first * 100, 0.0, 0.0, low, high)
    return Bar(parts["kept"] * 100, parts["lost"] * 100, parts["hit"] * 100, low, high)
