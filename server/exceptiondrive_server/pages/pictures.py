"""Pictures that other sites show beside a link (OpenGraph): a board, and one entry, as 1200 x 630 PNG.

Drawn as SVG by a template, from the same numbers as the page, and painted by resvg, which the client's
plots use too. It reads no network and no file but the fonts named here.
"""

import hashlib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from resvg_py import svg_to_bytes

from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.printable import counted
from exceptiondrive_server.pages.board_page import BoardReading
from exceptiondrive_server.pages.board_rows import Row, RowSetter
from exceptiondrive_server.pages.entry_facts import board_name, challenge_of, primary_metrics
from exceptiondrive_server.pages.entry_page import EntryReading
from exceptiondrive_server.pages.entry_standing import Standing, standing_of
from exceptiondrive_server.pages.headline import headline
from exceptiondrive_server.pages.numbers import Digits, day
from exceptiondrive_server.pages.picture_text import fitted, in_lines, is_latin
from exceptiondrive_server.pages.scales import px
from exceptiondrive_server.pages.templating import render

FONTS = sorted(str(path) for path in (Path(__file__).parent / "picture_fonts").glob("*.ttf"))
WIDTH, HEIGHT = 1200, 630
LEFT, RIGHT = 64, 1136
MAX_ROWS = 5
TRACK = (620, 1000)
TITLE_SIZE, NAME_SIZE, TITLE_WIDTH = 58, 64, 960


@dataclass(frozen=True)
class PictureRow:
    """One entry in the picture of a board."""

    y: int
    rank: str
    method: str
    value: str
    low: str | None
    width: str | None
    point: str
    source: str


@dataclass(frozen=True)
class BoardPicture:
    """Everything that the picture of a board shows."""

    subtitle: str
    title: tuple[str, ...]
    metric: str
    rows: tuple[PictureRow, ...]
    foot: str


@dataclass(frozen=True)
class Figure:
    """One big number."""

    x: int
    label: str
    value: str
    note: str


@dataclass(frozen=True)
class EntryPicture:
    """Everything that the picture of an entry shows."""

    subtitle: str
    title: tuple[str, ...]
    by: str
    figures: tuple[Figure, ...]
    marks: tuple[tuple[str, str], ...]
    this: str | None
    metric: str
    foot: str


def board_picture(reading: BoardReading) -> str:
    """Draw a board as SVG; without one, the question of its challenge."""
    board, phase = reading.board, reading.phase
    digits = Digits.of(reading.protocol.publication)
    challenge = phase.challenge if phase else None
    title = "How driving planners respond to hazards put into real scenes."
    if challenge is not None:
        title = headline(board, challenge, len(reading.protocol.tasks), digits).title
    return render(
        "picture_board.svg",
        picture=BoardPicture(
            subtitle=_subtitle(phase.title if phase else "", reading.protocol.version),
            title=in_lines(title, TITLE_SIZE, TITLE_WIDTH, 2),
            metric=f"{challenge.metrics[0].label}, %" if board and challenge else "",
            rows=_rows(board, digits) if board else (),
            foot=_foot(board) if board else "No board has been published yet.",
        ),
    )


def entry_picture(reading: EntryReading) -> str:
    """Draw an entry as SVG."""
    board, entry = reading.board, reading.entry
    setter = RowSetter.of(board, board.headline, Digits.of(reading.protocol.publication))
    row = setter.row(entry)
    first = challenge_of(board).metrics[0]
    return render(
        "picture_entry.svg",
        picture=EntryPicture(
            subtitle=_subtitle(reading.phase_title, reading.protocol.version),
            title=in_lines(entry.method, NAME_SIZE, TITLE_WIDTH, 2),
            by=fitted(entry.team or row.badge.word, 28, RIGHT - LEFT),
            figures=_figures(row, standing_of(row, board)),
            marks=_marks(setter, entry),
            this=_place(setter, entry),
            metric=f"{first.label}, %",
            foot=_foot(board),
        ),
    )


def picture_tag(svg: str) -> str:
    """Return the ETag of a picture: it is a function of its drawing."""
    return hashlib.sha256(svg.encode()).hexdigest()


@lru_cache(maxsize=128)
def painted(svg: str) -> bytes:
    """Paint a drawing as PNG; kept, as boards do not change.

    Names that the fonts here cannot set take those of the machine, where it has any.
    """
    png = svg_to_bytes(svg_string=svg, skip_system_fonts=is_latin(svg), font_files=FONTS)
    return bytes(png)


def _subtitle(phase: str, protocol: str) -> str:
    return fitted(f"{phase}, protocol {protocol}" if phase else "", 22, 560)


def _foot(board: Board) -> str:
    n_ranked = sum(entry.rank is not None for entry in board.entries)
    subject = challenge_of(board).words.subject
    return (
        f"{board_name(board)} of {day(board.published_at)}   ·   "
        f"{counted(board.n_samples, 'sample')}   ·   {counted(n_ranked, f'ranked {subject}')}"
    )


def _rows(board: Board, digits: Digits) -> tuple[PictureRow, ...]:
    setter = RowSetter.of(board, board.headline, digits)
    ranked = sorted((e for e in board.entries if e.rank is not None), key=lambda e: e.rank or 0)
    printed = [entry for entry in board.entries if entry.source == "reported"]
    rows = [setter.row(entry) for entry in (ranked or printed)[:MAX_ROWS]]
    return tuple(_row(at, row) for at, row in enumerate(rows))


def _row(at: int, row: Row) -> PictureRow:
    cell = row.cells[0]
    whisker = cell.whisker
    low = whisker.low if whisker else None
    width = whisker.width if whisker else None
    return PictureRow(
        y=318 + 46 * at,
        rank=row.rank or "–",
        method=fitted(row.entry.method, 26, TRACK[0] - LEFT - 76),
        value=cell.text or "none",
        low=None if low is None else _track(low),
        width=None if width is None else px(width / 100 * (TRACK[1] - TRACK[0])),
        point=_track(whisker.point) if whisker else "-99",
        source=row.entry.source,
    )


def _figures(row: Row, standing: Standing) -> tuple[Figure, ...]:
    primary = [cell for cell in row.cells if cell.role == "primary"]
    figures = [("Rank", standing.rank, standing.note or ("not ranked" if standing.why else ""))]
    for cell in primary:
        words = cell.whisker.words if cell.whisker else ""
        value = f"{cell.text}\u202f%" if cell.text else "none"
        figures.append((cell.label, value, words.replace("interval ", "")))
    return tuple(
        Figure(LEFT + 340 * at, label, value, fitted(note, 20, 320))
        for at, (label, value, note) in enumerate(figures)
    )


def _marks(setter: RowSetter, this: BoardEntry) -> tuple[tuple[str, str], ...]:
    """Place and source of all other entries by the metric that ranks first."""
    others = [entry for entry in setter.board.entries if entry is not this]
    placed = [(_place(setter, entry), entry.source) for entry in others]
    return tuple((x, source) for x, source in placed if x is not None)


def _place(setter: RowSetter, entry: BoardEntry) -> str | None:
    first = primary_metrics(setter.challenge)[0]
    value = entry.metrics.get(first.key)
    if value is None:
        return None
    return px(LEFT + setter.axes[first.key].clamped(value) / 100 * (RIGHT - LEFT))


def _track(per_cent: float) -> str:
    return px(TRACK[0] + per_cent / 100 * (TRACK[1] - TRACK[0]))
