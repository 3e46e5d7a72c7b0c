"""The page of one entry: its score sheet, breakdown, plausibility, history and receipt."""

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from urllib.parse import urlencode

from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.challenges import Challenge, Metric
from exceptiondrive_schemas.drawing import EntryDrawings
from exceptiondrive_schemas.protocol import PlausibilitySection, Protocol
from exceptiondrive_schemas.score_sheet import (
    BreakdownRow,
    Flag,
    Interval,
    Plausibility,
    ScoreSheet,
)
from exceptiondrive_server.boards.extra_tables import ExtraTable, effect_tables, extra_tables
from exceptiondrive_server.boards.family_tiles import SMALL_FAMILY
from exceptiondrive_server.boards.query import AVERAGE_TITLES
from exceptiondrive_server.boards.rows import Row, RowSetter
from exceptiondrive_server.entries.facts import (
    board_fields,
    challenge_of,
    entry_key,
    interval_of,
    outcome_parts,
)
from exceptiondrive_server.entries.history import History, PastStanding, history
from exceptiondrive_server.entries.sample_drawings import DrawnGroup, drawn_groups
from exceptiondrive_server.web.numbers import Digits, fixed, unit_of

# Families and tasks of one entry: numbers and outcome bars, ready to be set.


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


# What pages, badge and picture of an entry say of its rank: held, none, or none as it came late.


NO_RANK = "–"


@dataclass(frozen=True)
class Standing:
    """The rank of an entry in the words of its page."""

    rank: str
    """The rank held on the board; a dash where none is held."""
    note: str
    """Small print under the rank."""
    why: tuple[str, str] | None
    """Why no rank is held: what it is called, and the sentence; None where one is held."""
    words: str
    """All of it in one line."""


def standing_of(row: Row, board: Board) -> Standing:
    """Say what rank an entry holds. One that came after the deadline holds none on any board."""
    if row.entry.is_late:
        return _late(row, board)
    if row.rank is None:
        return Standing(NO_RANK, "", ("Not ranked.", _sentence(row.rank_words)), row.rank_words)
    note = f"{row.rank_interval} possible" if row.rank_interval else ""
    return Standing(row.rank, note, None, row.rank_words)


def _late(row: Row, board: Board) -> Standing:
    why = "It came after the deadline, so it holds no rank and moves none."
    if row.rank is None:
        return Standing(NO_RANK, "", ("Late.", f"{why} {_sentence(row.rank_words)}"), "late")
    n_ranked = sum(1 for entry in board.entries if entry.rank is not None)
    sentence = f"{why} Among all {n_ranked} of the late view it would be number {row.rank}."
    words = f"late, not ranked; it would be number {row.rank}"
    return Standing(NO_RANK, f"would be {row.rank}", ("Late.", sentence), words)


def _sentence(words: str) -> str:
    return words[0].upper() + words[1:] + ("" if words.endswith(".") else ".")


# Plausibility shares of an entry in words, each with the threshold of the protocol.


@dataclass(frozen=True)
class PlausibilityLine:
    """One share: what it counts, its value in per cent, when it raises a flag."""

    words: str
    value: str | None
    threshold: str
    flag: Flag | None


def plausibility_lines(
    plausibility: Plausibility, section: PlausibilitySection
) -> tuple[PlausibilityLine, ...]:
    """Return a line for every share that the score sheet publishes."""
    words = _words(section)
    raised = {flag.code: flag for flag in plausibility.flags}
    return tuple(
        PlausibilityLine(
            words=words.get(key, (key.replace("_", " "), "", ""))[0],
            value=None if share is None else fixed(share * 100, 1),
            threshold=words.get(key, ("", "", ""))[1],
            flag=raised.get(words.get(key, ("", "", ""))[2]),
        )
        for key, share in _in_order(plausibility.shares, words)
    )


def _words(section: PlausibilitySection) -> dict[str, tuple[str, str, str]]:
    """Share to its words, its threshold in words, and the flag that it may raise."""
    still = f"end less than {section.stationary_below_m:g} m from the start"
    return {
        "edited_stationary": (
            f"edited trajectories that {still}",
            f"more than {section.flag_edited_stationary_excess:.0%} above the source share",
            "stands_still",
        ),
        "source_stationary": (
            f"source trajectories that {still}",
            f"above {section.flag_source_stationary:.0%}",
            "source_stands_still",
        ),
        "blind": (
            f"pairs that differ by less than {section.blind_shift_below_m:g} m",
            f"above {section.flag_blind:.0%}",
            "blind_to_the_edit",
        ),
        "impossible": (
            (
                f"edited trajectories above {section.max_acceleration_mps2:g} m/s\u00b2 or turning "
                f"tighter than {section.min_turn_radius_m:g} m"
            ),
            f"above {section.flag_impossible:.0%}",
            "impossible_motion",
        ),
    }


def _in_order(
    shares: dict[str, float | None], words: dict[str, tuple[str, str, str]]
) -> list[tuple[str, float | None]]:
    """Known shares in the order of the protocol's section, then any others."""
    keys = [key for key in words if key in shares] + [key for key in shares if key not in words]
    return [(key, shares[key]) for key in keys]


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
