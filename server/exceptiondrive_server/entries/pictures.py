"""How other sites show an entry: its OpenGraph picture beside a link, its badge in a README."""

from exceptiondrive_schemas.board import BoardEntry
from exceptiondrive_server.boards.entry_facts import challenge_of, flags_of
from exceptiondrive_server.boards.pictures import (
    LEFT,
    RIGHT,
    TITLE_WIDTH,
    fitted,
    foot,
    in_two_lines,
    subtitle,
)
from exceptiondrive_server.boards.table import RowBuilder
from exceptiondrive_server.entries.queries import EntryData
from exceptiondrive_server.entries.view import WHOLE, position_of
from exceptiondrive_server.web.numbers import Digits, px
from exceptiondrive_server.web.templating import render

NAME_SIZE = 64


def entry_picture(reading: EntryData) -> str:
    """Draw an entry as SVG."""
    board, entry = reading.board, reading.entry
    publication = reading.protocol.publication
    digits = Digits.of(publication, has_fine_intervals=board.has_fine_intervals)
    builder = RowBuilder(board, board.headline, digits)
    row, first = builder.row(entry), challenge_of(board).metrics[0]
    position = position_of(row, board)
    figures = [("Rank", position.rank, position.note or ("not ranked" if position.reason else ""))]
    for cell in row.cells:
        if cell.role == "primary":
            value = f"{cell.text}\u202f%" if cell.text else "none"
            words = cell.whisker.words if cell.whisker else ""
            figures.append((cell.label, value, words.replace("interval ", "")))

    def place(shown: BoardEntry) -> str | None:
        value = shown.metrics.get(first.key)
        if value is None:
            return None
        return px(LEFT + WHOLE.clamped(value) / 100 * (RIGHT - LEFT))

    return render(
        "entries/picture.svg",
        picture={"subtitle": subtitle(reading.phase_title, reading.protocol.version), "foot": foot(board)},
        title=in_two_lines(entry.method, NAME_SIZE, TITLE_WIDTH),
        by=fitted(entry.team or row.badge.word, 28, RIGHT - LEFT),
        flags=fitted(f"Flagged: {flags_of(entry)}" if entry.flags else "", 26, RIGHT - LEFT),
        figures=[
            (LEFT + 340 * at, label, value, fitted(note, 20, 320))
            for at, (label, value, note) in enumerate(figures)
        ],
        marks=[
            (x, other.source)
            for other in board.entries
            if other is not entry and (x := place(other)) is not None
        ],
        this=place(entry),
        metric=f"{first.label}, 0 to 100 %",
    )  # fmt: skip


def badge(reading: EntryData) -> str:
    """Say rank, the first metric and flags as SVG, or that the entry is not ranked."""
    entry, metric = reading.entry, challenge_of(reading.board).metrics[0]
    text = Digits.of(reading.protocol.publication).text(metric, entry.metrics.get(metric.key))
    unranked = "not ranked" if entry.source == "scored" else entry.source
    rank = "late" if entry.is_late else f"rank {entry.rank}" if entry.rank else unranked
    parts = [rank, f"{metric.label} {text} %" if text else "no score"]
    parts += [f"flagged: {flags_of(entry)}"] if entry.flags else []
    return render("entries/badge.svg", words=", ".join(parts))
