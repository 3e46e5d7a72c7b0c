"""What pages, badge and picture of an entry say of its rank: held, none, or none as it came late."""

from dataclasses import dataclass

from exceptiondrive_schemas.board import Board
from exceptiondrive_server.pages.board_rows import Row

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
