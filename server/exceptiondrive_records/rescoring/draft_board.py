"""The board that is not shown yet: whether it says what the sheets say now."""

from sqlalchemy.orm import Session

from exceptiondrive_records.boards.boards import entry_ids, latest_board
from exceptiondrive_records.boards.ranking import entry_ids_for_board
from exceptiondrive_records.boards.tables import BoardRow
from exceptiondrive_records.phases.scoring_keys import ScoringKey
from exceptiondrive_records.work.board_requests import is_board_wanted, want_board


def fresh_board(session: Session, phase_id: str, key: ScoringKey) -> BoardRow | None:
    """Return the newest board under a key if it holds exactly the entries that are due now."""
    if is_board_wanted(session, phase_id, key.protocol_digest, key.split_revision):
        return None
    row = latest_board(session, phase_id, key.protocol_digest, key.split_revision)
    due = entry_ids_for_board(session, phase_id, key.protocol_digest, key.split_revision)
    return row if row is not None and entry_ids(session, row.id) == due else None


def want_fresh_board(session: Session, phase_id: str, key: ScoringKey) -> None:
    """Ask for the board under a key, once, unless it is fresh or asked for."""
    if is_board_wanted(session, phase_id, key.protocol_digest, key.split_revision):
        return
    if fresh_board(session, phase_id, key) is None:
        want_board(session, phase_id, key.protocol_digest, key.split_revision)
