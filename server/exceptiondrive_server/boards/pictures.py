"""The OpenGraph picture of a board, which other sites show beside a link: 1200 x 630 PNG.

A template draws it as SVG from the same numbers as the page, and resvg renders it, as it does the
client's plots. It reads no network, and no file but the fonts named here.
"""

import hashlib
from functools import lru_cache
from pathlib import Path

from fastapi import APIRouter, Request
from fastapi.responses import Response
from resvg_py import svg_to_bytes

from exceptiondrive_schemas.board import Board
from exceptiondrive_schemas.printable import counted
from exceptiondrive_server.boards.entry_facts import board_name, challenge_of, flags_of
from exceptiondrive_server.boards.headline import headline
from exceptiondrive_server.boards.page import BoardPage
from exceptiondrive_server.boards.queries import read_board
from exceptiondrive_server.boards.query import BoardQueryOf
from exceptiondrive_server.boards.table import Row, RowBuilder
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.etag import conditional
from exceptiondrive_server.web.numbers import Digits, Scale, day
from exceptiondrive_server.web.responses import SECURITY_HEADERS
from exceptiondrive_server.web.templating import render

_NARROW = frozenset("iljtfrI.,:;|!'()[]/ -·")
_WIDE = frozenset("mwMWO@%&QG+")
_WIDTHS = {"narrow": 0.34, "wide": 0.86, "capital": 0.68, "digit": 0.62, "other": 0.57}
ELLIPSIS = "…"


def width_of(text: str, size: float) -> float:
    """Estimate the width of `text`, erring on the wide side; non-Latin characters count one em."""
    return size * sum(_character_width(character) for character in text)


def _character_width(character: str) -> float:
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


def in_two_lines(text: str, size: float, width: float) -> tuple[str, ...]:
    """Break `text` between words into two lines of about one length, or one; cut what is too long."""
    lines = _two_lines(text, size, width)
    for share in (0.9, 0.8, 0.7, 0.6):
        narrower = _two_lines(text, size, width * share)
        if len(narrower) > len(lines) or any(line.endswith(ELLIPSIS) for line in narrower):
            break
        lines = narrower
    return lines


def _two_lines(text: str, size: float, width: float) -> tuple[str, ...]:
    words, taken = text.split(), 1
    while taken < len(words) and width_of(" ".join(words[: taken + 1]), size) <= width:
        taken += 1
    lines = " ".join(words[:taken]), " ".join(words[taken:])
    return tuple(fitted(line, size, width) for line in lines if line)


def is_latin(text: str) -> bool:
    """Whether the fonts of this package can set `text`."""
    return all(ord(c) < 0x250 or 0x2000 <= ord(c) < 0x2300 for c in text)


FONTS = sorted(str(path) for path in (Path(__file__).parent / "picture_fonts").glob("*.ttf"))
WIDTH, HEIGHT = 1200, 630
LEFT, RIGHT = 64, 1136
MAX_ROWS = 5
TRACK = Scale((0.0, 100.0), (620.0, 1000.0), ())
"""The axis of every row."""
TITLE_SIZE, TITLE_WIDTH = 50, 960


def board_picture(reading: BoardPage) -> str:
    """Draw a board as SVG; without one, the question of its challenge."""
    board, phase = reading.board, reading.phase
    digits = Digits.of(reading.protocol.publication)
    challenge = phase.challenge if phase else None
    title = "How driving planners respond to hazards put into driving scenes."
    if challenge is not None:
        title = headline(board, challenge, reading.protocol).title
    return render(
        "boards/picture_board.svg",
        picture={
            "subtitle": subtitle(phase.title if phase else "", reading.protocol.version),
            "foot": foot(board) if board else "No board has been published yet.",
        },
        title=in_two_lines(title, TITLE_SIZE, TITLE_WIDTH),
        metric=f"{challenge.metrics[0].label}, %" if board and challenge else "",
        rows=_rows(board, digits) if board else (),
        leader=board.leader if board else None,
        track=TRACK,
    )


@lru_cache(maxsize=128)
def paint_png(svg: str) -> bytes:
    """Paint a drawing as PNG; kept, as boards do not change.

    Names that the fonts here cannot set take those of the machine, where it has any.
    """
    png = svg_to_bytes(svg_string=svg, skip_system_fonts=is_latin(svg), font_files=FONTS)
    return bytes(png)


def subtitle(phase: str, protocol: str) -> str:
    """Name phase and protocol, beside the name of the site."""
    return fitted(f"{phase}, protocol {protocol}" if phase else "", 22, 560)


def foot(board: Board) -> str:
    """Name the board, and how much stands on it."""
    n_ranked = sum(entry.rank is not None for entry in board.entries)
    subject = challenge_of(board).words.subject
    return (
        f"{board_name(board)} of {day(board.published_at)}   ·   "
        f"{counted(board.n_samples, 'sample')}   ·   {counted(n_ranked, f'ranked {subject}')}"
    )


def _rows(board: Board, digits: Digits) -> list[tuple[Row, str, str]]:
    """The first entries by rank, each with its name and its flags as they fit."""
    builder = RowBuilder(board, board.headline, digits)
    ranked = sorted((e for e in board.entries if e.rank is not None), key=lambda e: e.rank or 0)
    room = TRACK.extent[0] - LEFT - 76
    return [
        (builder.row(each), fitted(each.method, 26, room), fitted(flags_of(each), 15, room))
        for each in ranked[:MAX_ROWS]
    ]


router = APIRouter(include_in_schema=False)


@router.get("/pictures/board.png")
def show_board_picture(request: Request, services: ServicesOf, query: BoardQueryOf) -> Response:
    """Paint a board: the one named, else the current one of the first phase."""
    with services.database.read() as session:
        reading = read_board(session, query)
    return painted_picture(request, board_picture(reading))


def painted_picture(request: Request, svg: str) -> Response:
    """Respond with the picture; for a client that has it, it is not painted again."""
    headers = {**SECURITY_HEADERS, "Cache-Control": "public, max-age=300"}
    tag = hashlib.sha256(svg.encode()).hexdigest()
    return conditional(request, lambda: paint_png(svg), "image/png", etag=tag, headers=headers)
