"""Which rows of a board are the signed-in team's own: marked for its members and nobody else."""

from dataclasses import dataclass

from exceptiondrive_schemas.board import Board
from exceptiondrive_server.pages.board_query import BoardQuery


@dataclass(frozen=True)
class OwnEntries:
    """The rows of a team on one board.

    Attributes:
        ids: Submissions of the team that stand on the board.
        words: A sentence about them, with the name under which the team stands there.
        url: The same board with these rows alone.
    """

    ids: frozenset[str]
    words: str
    url: str


def own_entries(
    board: Board, submission_ids: frozenset[str], query: BoardQuery
) -> OwnEntries | None:
    """Return what of a board belongs to a team; None where nothing does.

    Args:
        board: The board as everybody reads it, under pseudonyms perhaps.
        submission_ids: All submissions of the team.
        query: The page that is asked for.
    """
    own = [entry for entry in board.entries if entry.submission_id in submission_ids]
    if not own:
        return None
    ranks = [entry.rank for entry in own if entry.rank is not None]
    count = "one entry" if len(own) == 1 else f"{len(own)} entries"
    place = (
        "without a rank" if not ranks else f"{'' if len(own) == 1 else 'best '}rank {min(ranks)}"
    )
    return OwnEntries(
        ids=frozenset(entry.submission_id for entry in own if entry.submission_id),
        words=f"Your team stands here as {own[0].team}: {count}, {place}.",
        url=query.url(search=own[0].team, source=None),
    )
