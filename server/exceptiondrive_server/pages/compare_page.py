"""The compare page: entries of one board, the first two in full, all of them side by side."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from urllib.parse import urlencode

from exceptiondrive_records.errors import NotFound
from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.challenges import CHALLENGES, Challenge
from exceptiondrive_schemas.score_sheet import ScoreSheet
from exceptiondrive_server.pages.board_page import BoardReading, entry_choices
from exceptiondrive_server.pages.board_rows import Row, RowSetter
from exceptiondrive_server.pages.compare_many import MAX_COMPARED, ManyTable, many_table
from exceptiondrive_server.pages.comparison import Comparison, compare_entries, default_pair
from exceptiondrive_server.pages.difference_table import DifferenceTable, difference_table
from exceptiondrive_server.pages.entry_facts import (
    board_fields,
    challenge_of,
    entry_key,
    find_entry,
)
from exceptiondrive_server.pages.numbers import Digits
from exceptiondrive_server.pages.page_parts import PhaseLink
from exceptiondrive_server.pages.paired_table import find_pair


@dataclass(frozen=True)
class ComparePage:
    """Everything that `compare.html` needs; `both` is None where two entries are not there."""

    phase: PhaseLink | None
    board: Board | None
    challenge: Challenge
    both: Comparison | None
    rows: tuple[Row, ...]
    choices: tuple[tuple[str, str], ...]
    differences: DifferenceTable | None = None
    many: ManyTable | None = None
    keys: tuple[str, ...] = ()
    address: str = "/compare"
    """The whole comparison on this very board, to be shared."""
    swap_url: str = "/compare"
    is_current: bool = True

    @property
    def kept_fields(self) -> tuple[tuple[str, str], ...]:
        """What the form carries on unseen: which board is compared."""
        return board_fields(self.board, self.is_current) if self.board else ()

    @property
    def picture_url(self) -> str:
        """Address of the picture that other sites show."""
        board = self.board
        fields = board_fields(board) if board and board.view == "main" else ()
        return "/pictures/board.png" + (f"?{urlencode(fields)}" if fields else "")

    @property
    def more_keys(self) -> tuple[str, ...]:
        """Keys after the first two."""
        return self.keys[2:]

    @property
    def has_room(self) -> bool:
        """Whether one more may be added."""
        return len(self.keys) < MAX_COMPARED


def wanted_keys(pairs: Sequence[tuple[str, str]]) -> tuple[str | None, str | None, tuple[str, ...]]:
    """Read `a`, `b` and any number of `more` from an address; empty ones are nobody."""
    given = dict(pairs)
    more = dict.fromkeys(value for key, value in pairs if key == "more" and value)
    return given.get("a") or None, given.get("b") or None, tuple(more)


def chosen_entries(
    reading: BoardReading, a: str | None, b: str | None, more: Sequence[str] = ()
) -> tuple[BoardEntry, ...]:
    """Return the entries named `a`, `b` and `more`; without names the two best; () if there are none.

    Raises:
        NotFound: A named entry does not stand on this board.
    """
    board = reading.board
    pair = _pair(board, a, b) if board else None
    return _all_of(board, pair, more) if board and pair else ()


def compare_page(
    reading: BoardReading, entries: Sequence[BoardEntry], sheets: Mapping[str, ScoreSheet]
) -> ComparePage:
    """Compare entries of the board that was read.

    Args:
        reading: The board.
        entries: Two or more entries of it, or none.
        sheets: Published score sheets of the first two by key, where they were scored here.
    """
    board = reading.board
    if board is None or len(entries) < 2:
        phase = reading.phase
        challenge = phase.challenge if phase else next(iter(CHALLENGES.values()))
        choices = entry_choices(board) if board else ()
        return ComparePage(phase, board, challenge, None, (), choices)
    pair = (entries[0], entries[1])
    digits = Digits.of(reading.protocol.publication)
    setter = RowSetter.of(board, board.headline, digits, is_current=reading.is_current)
    keys = tuple(entry_key(entry) for entry in entries)
    return ComparePage(
        phase=reading.phase,
        board=board,
        challenge=challenge_of(board),
        both=compare_entries(board, *pair, digits),
        rows=tuple(setter.row(entry) for entry in entries),
        choices=_choices(board, entries),
        differences=difference_table(
            board,
            reading.protocol,
            pair,
            (sheets.get(keys[0]), sheets.get(keys[1])),
            find_pair(board, keys[0], keys[1]),
            digits,
        ),
        many=many_table(board, entries, digits, reading.is_current) if len(entries) > 2 else None,
        keys=keys,
        address=_address(board_fields(board), keys),
        swap_url=_address(board_fields(board, reading.is_current), (keys[1], keys[0], *keys[2:])),
        is_current=reading.is_current,
    )


def _all_of(
    board: Board, pair: tuple[BoardEntry, BoardEntry], more: Sequence[str]
) -> tuple[BoardEntry, ...]:
    """The pair, then the others once each, as many as are compared at once."""
    found = [entry for key in more if (entry := _named(board, key)) and entry not in pair]
    return (*pair, *found)[:MAX_COMPARED]


def _choices(board: Board, entries: Sequence[BoardEntry]) -> tuple[tuple[str, str], ...]:
    """The usual choices, and whoever else is compared."""
    offered = entry_choices(board)
    missing = [e for e in entries if entry_key(e) not in dict(offered)]
    return (*offered, *((entry_key(entry), entry.method) for entry in missing))


def _address(fields: Sequence[tuple[str, str]], keys: Sequence[str]) -> str:
    given = (*fields, ("a", keys[0]), ("b", keys[1]), *(("more", key) for key in keys[2:]))
    return f"/compare?{urlencode(given)}"


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
