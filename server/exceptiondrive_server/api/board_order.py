"""Another order of the same board: ranks stay, and a row without a value is always last."""

from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.challenges import CHALLENGES, ChallengeId

_BLOCKS = {"scored": 0, "reference": 1, "reported": 2}


def sorted_board(board: Board, sort: str) -> Board:
    """Return the board with its entries sorted by a metric, within scored, reference, reported.

    Args:
        board: Any board.
        sort: Metric key; `-` in front for descending.

    Raises:
        KeyError: The challenge has no such metric.
    """
    descending, key = sort.startswith("-"), sort.removeprefix("-")
    CHALLENGES[ChallengeId(board.challenge)].metric(key)

    def place(entry: BoardEntry) -> tuple[int, bool, float]:
        value = entry.metrics.get(key)
        signed = 0.0 if value is None else (-value if descending else value)
        return _BLOCKS[entry.source], value is None, signed

    return board.model_copy(update={"entries": tuple(sorted(board.entries, key=place))})
