"""The compare page: two entries of one board, and links to other pairs."""

from dataclasses import dataclass

from exceptiondrive_records.errors import NotFound
from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.challenges import Challenge
from exceptiondrive_server.pages.board_page import BoardReading, entry_choices
from exceptiondrive_server.pages.board_rows import Row, RowSetter
from exceptiondrive_server.pages.comparison import Comparison, compare_entries, default_pair
from exceptiondrive_server.pages.entry_facts import challenge_of, find_entry
from exceptiondrive_server.pages.numbers import Digits
from exceptiondrive_server.pages.page_parts import PhaseLink


@dataclass(frozen=True)
class ComparePage:
    """Everything that `compare.html` needs; `both` is None where two entries are not there."""

    phase: PhaseLink | None
    board: Board | None
    challenge: Challenge | None
    both: Comparison | None
    rows: tuple[Row, Row] | None
    choices: tuple[tuple[str, str], ...]


def compare_page(reading: BoardReading, a: str | None, b: str | None) -> ComparePage:
    """Compare the entries named `a` and `b`; without names, the two best.

    Raises:
        NotFound: A named entry does not stand on this board.
    """
    board = reading.board
    if board is None:
        return ComparePage(reading.phase, None, None, None, None, ())
    pair = _pair(board, a, b)
    digits = Digits.of(reading.protocol.publication)
    setter = RowSetter.of(board, board.headline, digits, is_current=reading.is_current)
    return ComparePage(
        phase=reading.phase,
        board=board,
        challenge=challenge_of(board),
        both=compare_entries(board, *pair, digits) if pair else None,
        rows=(setter.row(pair[0]), setter.row(pair[1])) if pair else None,
        choices=entry_choices(board),
    )


def _pair(board: Board, a: str | None, b: str | None) -> tuple[BoardEntry, BoardEntry] | None:
    named = [_named(board, key) for key in (a, b)]
    fallback = default_pair(board)
    if named[0] and named[1]:
        return named[0], named[1]
    if fallback is None:
        return None
    if named[0] or named[1]:
        given = named[0] or named[1]
        assert given is not None
        other = fallback[0] if fallback[0] is not given else fallback[1]
        return (given, other) if named[0] else (other, given)
    return fallback


def _named(board: Board, key: str | None) -> BoardEntry | None:
    if not key:
        return None
    entry = find_entry(board, key)
    if entry is None:
        raise NotFound("entry on this board", key)
    return entry
