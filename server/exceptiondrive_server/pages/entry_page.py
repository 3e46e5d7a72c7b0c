"""The page of one entry: its score sheet, breakdown, plausibility, history and receipt."""

from dataclasses import dataclass
from datetime import datetime
from urllib.parse import urlencode

from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.challenges import Challenge, Metric
from exceptiondrive_schemas.drawing import EntryDrawings
from exceptiondrive_schemas.protocol import Protocol
from exceptiondrive_schemas.score_sheet import ScoreSheet
from exceptiondrive_server.pages.board_query import AVERAGE_TITLES
from exceptiondrive_server.pages.board_rows import Row, RowSetter
from exceptiondrive_server.pages.breakdown import BreakdownLine, breakdown_lines
from exceptiondrive_server.pages.effect_table import effect_tables
from exceptiondrive_server.pages.entry_facts import (
    board_fields,
    challenge_of,
    entry_key,
    interval_of,
)
from exceptiondrive_server.pages.entry_history import History, PastStanding, history
from exceptiondrive_server.pages.entry_standing import Standing, standing_of
from exceptiondrive_server.pages.extra_tables import ExtraTable, extra_tables
from exceptiondrive_server.pages.numbers import Digits, fixed, unit_of
from exceptiondrive_server.pages.plausibility_words import PlausibilityLine, plausibility_lines
from exceptiondrive_server.pages.sample_drawings import DrawnGroup, drawn_groups


@dataclass(frozen=True)
class Receipt:
    """What was uploaded, and when it came."""

    file_digest: str
    size_bytes: int
    received_at: datetime


@dataclass(frozen=True)
class EntryReading:
    """What the records say of an entry."""

    board: Board
    entry: BoardEntry
    protocol: Protocol
    phase_title: str
    is_current: bool
    sheet: ScoreSheet | None
    receipt: Receipt | None
    past: tuple[PastStanding, ...]
    drawings: EntryDrawings | None


@dataclass(frozen=True)
class AggregateLine:
    """One metric under both averages."""

    metric: Metric
    unit: str
    headline: str | None
    other: str | None
    interval: str | None


@dataclass(frozen=True)
class StripMark:
    """One entry on the strip that shows where all stand."""

    at: float
    source: str
    is_this: bool
    title: str


@dataclass(frozen=True)
class EntryPage:
    """Everything that `entry.html` needs."""

    reading: EntryReading
    challenge: Challenge
    row: Row
    standing: Standing
    board_url: str
    """The board that shows it, current, late or old."""
    picture_url: str
    axis: tuple[str, str]
    strip: tuple[StripMark, ...]
    headline_title: str
    other_title: str
    aggregates: tuple[AggregateLine, ...]
    lines: tuple[BreakdownLine, ...]
    outcome_words: dict[str, str]
    plausibility: tuple[PlausibilityLine, ...]
    history: History | None
    drawn: tuple[DrawnGroup, ...]
    extra: tuple[ExtraTable, ...]
    neighbours: tuple[tuple[str, str, str], ...]
    key: str


def entry_page(reading: EntryReading) -> EntryPage:
    """Set what was read of an entry."""
    board, entry = reading.board, reading.entry
    challenge, digits = challenge_of(board), Digits.of(reading.protocol.publication)
    setter = RowSetter.of(board, board.headline, digits, is_current=reading.is_current)
    first = challenge.metrics[0]
    low, high = setter.axes[first.key].domain
    other = "micro" if board.headline == "macro_family" else "macro_family"
    sheet, row = reading.sheet, setter.row(entry)
    section = reading.protocol.plausibility
    return EntryPage(
        reading=reading,
        challenge=challenge,
        row=row,
        standing=standing_of(row, board),
        board_url=f"/?{urlencode(board_fields(board, reading.is_current))}#board",
        picture_url=f"/pictures/entries/{entry_key(entry)}.png?{_picture_query(board)}",
        axis=(fixed(low * 100, 0), fixed(high * 100, 0)),
        strip=_strip(setter, entry),
        headline_title=AVERAGE_TITLES[board.headline],
        other_title="over samples" if other == "micro" else "over families",
        aggregates=tuple(_aggregate(board, entry, metric, digits) for metric in challenge.metrics),
        lines=breakdown_lines(board, entry, sheet, reading.protocol, digits),
        outcome_words={str(k): v for k, v in challenge.words.outcome.items()},
        plausibility=plausibility_lines(sheet.plausibility, section) if sheet else (),
        history=history(reading.past, board, digits),
        drawn=drawn_groups(reading.drawings, board, entry, reading.protocol, reading.is_current),
        extra=(
            *effect_tables(board, entry, digits),
            *(extra_tables(sheet, reading.protocol, digits) if sheet else ()),
        ),
        neighbours=_neighbours(reading),
        key=entry_key(entry),
    )


def _aggregate(board: Board, entry: BoardEntry, metric: Metric, digits: Digits) -> AggregateLine:
    interval = interval_of(entry, board, board.headline, metric.key)
    other = entry.micro if board.headline == "macro_family" else entry.macro_family
    return AggregateLine(
        metric=metric,
        unit=unit_of(metric),
        headline=digits.text(metric, entry.metrics.get(metric.key)),
        other=digits.text(metric, other.get(metric.key)),
        interval=f"{digits.text(metric, interval[0])} to {digits.text(metric, interval[1])}"
        if interval
        else None,
    )


def _strip(setter: RowSetter, this: BoardEntry) -> tuple[StripMark, ...]:
    metric = setter.challenge.metrics[0]
    marks = []
    for entry in setter.board.entries:
        value = entry.metrics.get(metric.key)
        if value is not None:
            text = f"{entry.method} {setter.digits.text(metric, value)} {unit_of(metric)}"
            at = setter.axes[metric.key].clamped(value)
            marks.append(StripMark(at, entry.source, entry is this, text))
    return tuple(sorted(marks, key=lambda mark: mark.is_this))


def _picture_query(board: Board) -> str:
    """A picture of the late view follows it; one of a board never changes."""
    given = (("phase", board.phase),) if board.view == "late" else board_fields(board)
    return urlencode(given)


def _neighbours(reading: EntryReading) -> tuple[tuple[str, str, str], ...]:
    """Comparisons with the entries just above and below on this board: words, method, address."""
    board, entry = reading.board, reading.entry
    ranked = [other for other in board.entries if other.rank is not None]
    if entry not in ranked:
        others = [("the leader", ranked[0])] if ranked else []
    else:
        place = ranked.index(entry)
        others = [("the entry above", ranked[place - 1])] if place else []
        others += [("the entry below", ranked[place + 1])] if place + 1 < len(ranked) else []
    given = (*board_fields(board, reading.is_current), ("a", entry_key(entry)))
    base = f"/compare?{urlencode(given)}&b="
    return tuple((words, other.method, base + entry_key(other)) for words, other in others)
