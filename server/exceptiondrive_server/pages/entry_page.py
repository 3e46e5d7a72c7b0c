"""The page of one entry: what its template needs besides the documents that were read."""

from collections.abc import Iterator
from typing import Any, NamedTuple
from urllib.parse import urlencode

from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.challenges import Challenge, Metric
from exceptiondrive_schemas.score_sheet import BreakdownRow, Interval
from exceptiondrive_server.pages.board_query import AVERAGE_TITLES
from exceptiondrive_server.pages.board_rows import RowSetter
from exceptiondrive_server.pages.effect_table import effect_tables
from exceptiondrive_server.pages.entry_facts import (
    board_fields,
    challenge_of,
    entry_key,
    outcome_parts,
)
from exceptiondrive_server.pages.entry_readings import EntryReading
from exceptiondrive_server.pages.entry_standing import standing_of
from exceptiondrive_server.pages.extra_tables import extra_tables
from exceptiondrive_server.pages.family_tiles import SMALL_FAMILY
from exceptiondrive_server.pages.numbers import Digits
from exceptiondrive_server.pages.plausibility_words import plausibility_lines
from exceptiondrive_server.pages.sample_drawings import panels
from exceptiondrive_server.pages.scales import Scale, nice_scale


class Part(NamedTuple):
    """One family or task of an entry."""

    id: str
    title: str
    hazard: str
    """Of a task; a family has none of its own."""
    row: BreakdownRow
    interval: Interval | None
    """Of the first metric."""
    is_family: bool

    @property
    def is_small(self) -> bool:
        """Whether its numbers come from few samples."""
        return self.row.n is not None and self.row.n < SMALL_FAMILY

    def bar(self, challenge: Challenge) -> dict[str, float] | None:
        """Return the outcome's three shares; of a paper that prints one metric alone, that one."""
        values = self.row.metrics
        first = values.get(challenge.metrics[0].key)
        alone = None if first is None else {"kept": first, "lost": 0.0, "hit": 0.0}
        parts = outcome_parts(challenge, values)
        return alone if parts is None else {str(name): share for name, share in parts.items()}


def entry_page(reading: EntryReading) -> dict[str, Any]:
    """Return what `entry.html` shows of an entry."""
    board, entry, sheet = reading.board, reading.entry, reading.sheet
    challenge, digits = challenge_of(board), Digits.of(reading.protocol.publication)
    setter = RowSetter.of(board, board.headline, digits, is_current=reading.is_current)
    row, plausibility = setter.row(entry), reading.protocol.plausibility
    is_macro = board.headline == "macro_family"
    return {
        "reading": reading,
        "challenge": challenge,
        "digits": digits,
        "row": row,
        "standing": standing_of(row, board),
        "axis": setter.axes[challenge.metrics[0].key],
        "averages": (AVERAGE_TITLES[board.headline], AVERAGE_TITLES["micro" if is_macro else "macro_family"]),
        "other": entry.micro if is_macro else entry.macro_family,
        "parts": tuple(_parts(reading, challenge.metrics[0])),
        "plausibility": plausibility_lines(sheet.plausibility, plausibility) if sheet else (),
        "past_axis": _past_axis(reading, challenge.metrics[0]),
        "panels": panels(reading),
        "tables": (
            *effect_tables(board, entry, digits),
            *(extra_tables(sheet, reading.protocol, digits) if sheet else ()),
        ),
        "neighbours": _neighbours(reading),
        "board_url": f"/?{urlencode(board_fields(board, reading.is_current))}#board",
        "picture_url": f"/pictures/entries/{entry_key(entry)}.png?{_picture_query(board)}",
    }  # fmt: skip


def _parts(reading: EntryReading, first: Metric) -> Iterator[Part]:
    """Each family of an entry, followed by its tasks where a score sheet is known."""
    tasks = reading.sheet.tasks if reading.sheet else {}
    for head in reading.board.families:
        cell = reading.entry.families.get(head.id)
        if cell is not None:
            yield Part(head.id, head.title, "", cell, cell.intervals.get(first.key), True)
            for task in reading.protocol.taxonomy.tasks_of(head.id):
                if task.id in tasks:
                    yield Part(task.id, task.title, task.hazard, tasks[task.id], None, False)


def _past_axis(reading: EntryReading, metric: Metric) -> Scale:
    """One axis for all protocols under which the entry stood."""
    values: list[float | None] = []
    for past in reading.past:
        interval = past.entry.intervals.get(metric.key) or ()
        values += [past.entry.metrics.get(metric.key), *interval]
    known = [value for value in values if value is not None]
    return nice_scale(known, (0.0, 100.0), n_ticks=4, floor=0.0, ceiling=1.0)


def _picture_query(board: Board) -> str:
    """A picture of the late view follows it; one of a board never changes."""
    given = (("phase", board.phase),) if board.view == "late" else board_fields(board)
    return urlencode(given)


def _neighbours(reading: EntryReading) -> list[tuple[str, BoardEntry, str]]:
    """Comparisons with the entries just above and below on this board: words, entry, address."""
    board, entry = reading.board, reading.entry
    ranked = [other for other in board.entries if other.rank is not None]
    if entry not in ranked:
        others = [("the leader", other) for other in ranked[:1]]
    else:
        place = ranked.index(entry)
        others = [("the entry above", other) for other in ranked[max(place - 1, 0) : place]]
        others += [("the entry below", other) for other in ranked[place + 1 : place + 2]]
    given = (*board_fields(board, reading.is_current), ("a", entry_key(entry)))
    base = f"/compare?{urlencode(given)}&b="
    return [(words, other, base + entry_key(other)) for words, other in others]
