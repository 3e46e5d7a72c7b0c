"""Comparisons of recorded boards, kept in memory: a board never changes, so neither do these.

Whoever previews a run, or watches it, works the comparison out; the transaction that flips the
pointer then finds it here, and holds its locks for no arithmetic.
"""

from dataclasses import dataclass
from functools import lru_cache

from exceptiondrive_records.rescoring.comparison import compare_boards
from exceptiondrive_records.tables import BoardRow
from exceptiondrive_schemas.board import Board
from exceptiondrive_schemas.rescoring import Comparison

_KEPT = 4
"""Pairs of boards: those of the open runs, a megabyte or so each at 1,000 entries."""


@dataclass(frozen=True)
class Compared:
    """A comparison and its digest, both worked out once."""

    comparison: Comparison
    digest: str


def compare_rows(old: BoardRow, new: BoardRow) -> Compared:
    """Return what changes from one recorded board to another."""
    return _compared(old.body, new.body)


@lru_cache(maxsize=_KEPT)
def _compared(old_body: str, new_body: str) -> Compared:
    boards = (Board.model_validate_json(body) for body in (old_body, new_body))
    comparison = compare_boards(*boards)
    return Compared(comparison, comparison.digest)
