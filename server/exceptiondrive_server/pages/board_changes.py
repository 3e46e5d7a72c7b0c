"""What a board changed since the board before it, in one plain line; and the list of all boards."""

from dataclasses import dataclass
from datetime import datetime

from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.printable import counted
from exceptiondrive_schemas.rescoring import BoardHistoryLine
from exceptiondrive_server.pages.numbers import day, listed, minute

MAX_NAMED = 3


@dataclass(frozen=True)
class BoardBefore:
    """The board that was shown before, without its entries."""

    number: int
    protocol: str
    published_at: datetime


@dataclass(frozen=True)
class ChangeLine:
    """The line, and where the whole history stands."""

    words: str
    history_url: str
    protocol_url: str | None
    """The page that says what the new protocol changed."""


def change_line(board: Board, before: BoardBefore | None) -> ChangeLine:
    """Say what is new: the protocol, entries, ranks."""
    history_url = f"/history?phase={board.phase}"
    if before is None:
        return ChangeLine("This is the first board of its phase.", history_url, None)
    is_updated = before.protocol != board.protocol.version
    parts = [f"protocol {before.protocol} became {board.protocol.version}"] if is_updated else []
    parts += _entry_parts(board)
    since = f"Since board {before.number} of {day(before.published_at)}"
    words = f"{since}: {'; '.join(parts)}." if parts else f"{since} no rank moved."
    return ChangeLine(
        words, history_url, f"/protocols/{board.protocol.version}" if is_updated else None
    )


def _entry_parts(board: Board) -> list[str]:
    ranked = [entry for entry in board.entries if entry.rank is not None]
    new = [entry for entry in ranked if entry.previous_rank is None]
    up = [entry for entry in ranked if _steps_up(entry) > 0]
    down = [entry for entry in ranked if _steps_up(entry) < 0]
    parts = []
    if new:
        parts.append(f"{counted(len(new), 'new entry', 'new entries')}{_named(new)}")
    if up:
        parts.append(f"{len(up)} moved up{_named(up)}")
    if down:
        parts.append(f"{len(down)} moved down{_named(down)}")
    return parts


def _named(entries: list[BoardEntry]) -> str:
    """Name a few; of many, none."""
    if len(entries) > MAX_NAMED:
        return ""
    return f" ({listed([f'{entry.method} to rank {entry.rank}' for entry in entries])})"


def _steps_up(entry: BoardEntry) -> int:
    if entry.rank is None or entry.previous_rank is None:
        return 0
    return entry.previous_rank - entry.rank


@dataclass(frozen=True)
class HistoryLine:
    """One stretch of time in which one board was shown."""

    board: int
    url: str
    protocol: str
    shown: str
    is_current: bool
    what_changed: tuple[str, ...]
    comparison: str | None


def history_lines(phase: str, lines: list[BoardHistoryLine]) -> tuple[HistoryLine, ...]:
    """Set the boards that were ever public, newest first."""
    return tuple(
        HistoryLine(
            board=line.board,
            url=f"/?phase={phase}&board={line.board}#board",
            protocol=line.protocol.version,
            shown=f"{minute(line.shown_from)} to "
            + (minute(line.shown_until) if line.shown_until else "now"),
            is_current=line.shown_until is None,
            what_changed=line.what_changed,
            comparison=line.comparison,
        )
        for line in lines
    )
