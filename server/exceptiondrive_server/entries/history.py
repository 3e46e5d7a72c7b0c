"""Where an entry stood under each protocol: rank and score with intervals, on one shared axis."""

from collections.abc import Sequence
from dataclasses import dataclass

from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.challenges import Metric
from exceptiondrive_server.boards.rows import Whisker
from exceptiondrive_server.boards.scales import Scale, nice_scale
from exceptiondrive_server.entries.facts import (
    challenge_of,
    entry_url,
    interval_of,
    primary_metrics,
)
from exceptiondrive_server.web.numbers import DASH, Digits, fixed, listed


@dataclass(frozen=True)
class PastStanding:
    """An entry on the newest board of one protocol that shows it, and on the oldest."""

    board: Board
    entry: BoardEntry
    first_board: Board
    first_entry: BoardEntry


@dataclass(frozen=True)
class HistoryLine:
    """One protocol version."""

    protocol: str
    is_shown: bool
    rank: str
    rank_interval: str
    came_in: str
    texts: tuple[str | None, ...]
    whisker: Whisker | None
    board: int
    board_url: str
    entry_url: str
    published: Board


@dataclass(frozen=True)
class History:
    """The table of an entry's history, and the ends of its axis."""

    label: str
    heads: tuple[str, ...]
    axis: tuple[str, str]
    lines: tuple[HistoryLine, ...]


def history(past: Sequence[PastStanding], shown: Board, digits: Digits) -> History | None:
    """Set the standings of an entry, newest protocol first; None where it stands on no board."""
    if not past:
        return None
    metrics = primary_metrics(challenge_of(shown))
    axis = _axis(past, metrics[0])
    return History(
        label=metrics[0].label,
        heads=tuple(f"{metric.label} %" for metric in metrics),
        axis=(fixed(axis.domain[0] * 100, 0), fixed(axis.domain[1] * 100, 0)),
        lines=tuple(_line(each, shown, metrics, axis, digits) for each in past),
    )


def _line(
    past: PastStanding, shown: Board, metrics: Sequence[Metric], axis: Scale, digits: Digits
) -> HistoryLine:
    board, entry = past.board, past.entry
    n_ranked = sum(1 for each in board.entries if each.rank is not None)
    is_shown = board.board == shown.board
    low, high = entry.rank_interval or (None, None)
    return HistoryLine(
        protocol=board.protocol.version,
        is_shown=is_shown,
        rank="not ranked" if entry.rank is None else f"{entry.rank} of {n_ranked}",
        rank_interval="" if low is None else f"{low}{DASH}{high}" if low != high else str(low),
        came_in=_came_in(past),
        texts=tuple(digits.text(metric, entry.metrics.get(metric.key)) for metric in metrics),
        whisker=_whisker(entry, board, metrics[0], axis, digits),
        board=board.board,
        board_url=f"/?phase={board.phase}&board={board.board}#board",
        entry_url=entry_url(entry, board, is_current=False),
        published=board,
    )


def _came_in(past: PastStanding) -> str:
    """Say where it came in, if the board has changed since."""
    if past.first_board.board == past.board.board or past.first_entry.rank is None:
        return ""
    return f"came in at {past.first_entry.rank} on board {past.first_board.board}"


def _axis(past: Sequence[PastStanding], metric: Metric) -> Scale:
    values: list[float] = []
    for each in past:
        value = each.entry.metrics.get(metric.key)
        interval = interval_of(each.entry, each.board, each.board.headline, metric.key)
        values += [] if value is None else [value]
        values += [] if interval is None else list(interval)
    return nice_scale(values, (0.0, 100.0), n_ticks=4, floor=0.0, ceiling=1.0)


def _whisker(
    entry: BoardEntry, board: Board, metric: Metric, axis: Scale, digits: Digits
) -> Whisker | None:
    value = entry.metrics.get(metric.key)
    if value is None:
        return None
    interval = interval_of(entry, board, board.headline, metric.key)
    if interval is None:
        return Whisker(axis.at(value), None, None, False, "")
    low, high = axis.at(interval[0]), axis.at(interval[1])
    ends = listed([digits.text(metric, end) or "" for end in interval], "to")
    words = f"{board.confidence:.0%} interval {ends}"
    return Whisker(axis.at(value), low, high - low, False, words)
