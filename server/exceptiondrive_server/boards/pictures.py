"""Pictures that other sites show beside a link (OpenGraph): a board, and one entry, as 1200 x 630 PNG.

Drawn as SVG by a template, from the same numbers as the page, and painted by resvg, which the client's
plots use too. It reads no network and no file but the fonts named here.
"""

import hashlib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from fastapi import APIRouter, Request
from fastapi.responses import Response
from resvg_py import svg_to_bytes

from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.printable import counted
from exceptiondrive_server.boards.entry_facts import board_name, challenge_of, primary_metrics
from exceptiondrive_server.boards.headline import headline
from exceptiondrive_server.boards.page import BoardPage
from exceptiondrive_server.boards.queries import read_board
from exceptiondrive_server.boards.query import AskedBoard
from exceptiondrive_server.boards.table import Row, RowBuilder
from exceptiondrive_server.entries.queries import EntryReading, read_entry
from exceptiondrive_server.entries.view import Standing, standing_of
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.etag import conditional
from exceptiondrive_server.web.numbers import Digits, day
from exceptiondrive_server.web.responses import SECURITY_HEADERS, render
from exceptiondrive_server.web.scales import px

# Words in a picture: SVG text neither wraps nor ends by itself.


_NARROW = frozenset("iljtfrI.,:;|!'()[]/ -·")
_WIDE = frozenset("mwMWO@%&QG+")
_WIDTHS = {"narrow": 0.34, "wide": 0.86, "capital": 0.68, "digit": 0.62, "other": 0.57}
ELLIPSIS = "…"


def width_of(text: str, size: float) -> float:
    """Estimate the width of `text`, rather too wide; characters beyond Latin count one em."""
    return size * sum(_em(character) for character in text)


def _em(character: str) -> float:
    if character in _NARROW:
        return _WIDTHS["narrow"]
    if character in _WIDE:
        return _WIDTHS["wide"]
    if ord(character) > 0x2FF and character not in "\u2009\u202f\u2013\u2019\u2026\u2212":
        return 1.0
    if character.isupper():
        return _WIDTHS["capital"]
    return _WIDTHS["digit"] if character.isdigit() else _WIDTHS["other"]


def fitted(text: str, size: float, width: float) -> str:
    """Return `text`, cut with an ellipsis where it is too wide; without control characters."""
    text = " ".join("".join(c if c.isprintable() else " " for c in text).split())
    if width_of(text, size) <= width:
        return text
    while text and width_of(text + ELLIPSIS, size) > width:
        text = text[:-1]
    return text.rstrip() + ELLIPSIS


def in_lines(text: str, size: float, width: float, n_lines: int) -> tuple[str, ...]:
    """Break `text` between words into at most `n_lines` of about one length; cut what is too long."""
    lines = _broken(text, size, width, n_lines)
    for share in (0.9, 0.8, 0.7, 0.6):
        narrower = _broken(text, size, width * share, n_lines)
        if len(narrower) > len(lines) or any(line.endswith(ELLIPSIS) for line in narrower):
            break
        lines = narrower
    return lines


def _broken(text: str, size: float, width: float, n_lines: int) -> tuple[str, ...]:
    lines: list[str] = []
    words = text.split()
    while words and len(lines) < n_lines - 1:
        taken = 1
        while taken < len(words) and width_of(" ".join(words[: taken + 1]), size) <= width:
            taken += 1
        lines.append(fitted(" ".join(words[:taken]), size, width))
        words = words[taken:]
    return (*lines, fitted(" ".join(words), size, width)) if words else tuple(lines)


def is_latin(text: str) -> bool:
    """Whether the fonts of this package can set `text`."""
    return all(ord(c) < 0x250 or 0x2000 <= ord(c) < 0x2300 for c in text)


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


def board_picture(reading: BoardPage) -> str:
    """Draw a board as SVG; without one, the question of its challenge."""
    board, phase = reading.board, reading.phase
    digits = Digits.of(reading.protocol.publication)
    challenge = phase.challenge if phase else None
    title = "How driving planners respond to hazards put into real scenes."
    if challenge is not None:
        title = headline(board, challenge, len(reading.protocol.tasks), digits).title
    return render(
        "boards/picture_board.svg",
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
    builder = RowBuilder.of(board, board.headline, Digits.of(reading.protocol.publication))
    row = builder.row(entry)
    first = challenge_of(board).metrics[0]
    return render(
        "boards/picture_entry.svg",
        picture=EntryPicture(
            subtitle=_subtitle(reading.phase_title, reading.protocol.version),
            title=in_lines(entry.method, NAME_SIZE, TITLE_WIDTH, 2),
            by=fitted(entry.team or row.badge.word, 28, RIGHT - LEFT),
            figures=_figures(row, standing_of(row, board)),
            marks=_marks(builder, entry),
            this=_place(builder, entry),
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
    builder = RowBuilder.of(board, board.headline, digits)
    ranked = sorted((e for e in board.entries if e.rank is not None), key=lambda e: e.rank or 0)
    printed = [entry for entry in board.entries if entry.source == "reported"]
    rows = [builder.row(entry) for entry in (ranked or printed)[:MAX_ROWS]]
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


def _marks(builder: RowBuilder, this: BoardEntry) -> tuple[tuple[str, str], ...]:
    """Place and source of all other entries by the metric that ranks first."""
    others = [entry for entry in builder.board.entries if entry is not this]
    placed = [(_place(builder, entry), entry.source) for entry in others]
    return tuple((x, source) for x, source in placed if x is not None)


def _place(builder: RowBuilder, entry: BoardEntry) -> str | None:
    first = primary_metrics(builder.challenge)[0]
    value = entry.metrics.get(first.key)
    if value is None:
        return None
    return px(LEFT + builder.axes[first.key].clamped(value) / 100 * (RIGHT - LEFT))


def _track(per_cent: float) -> str:
    return px(TRACK[0] + per_cent / 100 * (TRACK[1] - TRACK[0]))


# An SVG badge of one entry, for a README.


CHARACTER_WIDTH = 6.6
PADDING = 18
NAME = "ExceptionDrive"


@dataclass(frozen=True)
class Badge:
    """Widths and words of a badge."""

    width: str
    name_width: str
    name_middle: str
    words_middle: str
    name: str
    words: str


def _badge_place(entry: BoardEntry) -> str:
    if entry.is_late:
        return "late"
    return f"rank {entry.rank}" if entry.rank else entry.source


def badge_of(reading: EntryReading) -> Badge:
    """Say rank and the first metric, or that the entry is reported or not ranked."""
    metric = challenge_of(reading.board).metrics[0]
    digits = Digits.of(reading.protocol.publication)
    text = digits.text(metric, reading.entry.metrics.get(metric.key))
    score = f"{metric.label} {text} %" if text else "no score"
    words = f"{_badge_place(reading.entry)}, {score}"
    name_width = len(NAME) * CHARACTER_WIDTH + PADDING
    words_width = len(words) * CHARACTER_WIDTH + PADDING
    return Badge(
        width=px(name_width + words_width),
        name_width=px(name_width),
        name_middle=px(name_width / 2),
        words_middle=px(name_width + words_width / 2),
        name=NAME,
        words=words,
    )


# Routes of the pictures that other sites show beside a link.


router = APIRouter(include_in_schema=False)


@router.get("/pictures/board.png")
def show_board_picture(request: Request, services: ServicesOf, query: AskedBoard) -> Response:
    """Paint a board: the one named, else the current one of the first phase."""
    with services.database.read() as session:
        reading = read_board(session, query)
    return _picture(request, board_picture(reading))


@router.get("/pictures/entries/{key}.png")
def show_entry_picture(
    request: Request, services: ServicesOf, query: AskedBoard, key: str
) -> Response:
    """Paint an entry as it stands, or stood, on a board."""
    with services.database.read() as session:
        reading = read_entry(session, key, query)
    return _picture(request, entry_picture(reading))


def _picture(request: Request, svg: str) -> Response:
    """Answer with the picture; one that the reader has is not painted again."""
    headers = {**SECURITY_HEADERS, "Cache-Control": "public, max-age=300"}
    return conditional(
        request, lambda: painted(svg), "image/png", etag=picture_tag(svg), headers=headers
    )
