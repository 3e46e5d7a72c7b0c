"""The board that is not shown yet: whether it says what the sheets say now."""

import json

from sqlalchemy import select
from sqlalchemy.orm import Session

from exceptiondrive_records.board_requests import want_board
from exceptiondrive_records.boards import is_board_wanted, latest_board
from exceptiondrive_records.rescoring.keys import ScoringKey
from exceptiondrive_records.tables import BoardRow, ScoreSheetRow, Submission
from exceptiondrive_schemas.submission import SubmissionStatus


def fresh_board(session: Session, phase_id: str, key: ScoringKey) -> BoardRow | None:
    """Return the newest board under a key if it holds exactly the entries that are due now."""
    if is_board_wanted(session, phase_id, key.protocol_digest, key.split_revision):
        return None
    row = latest_board(session, phase_id, key.protocol_digest, key.split_revision)
    if row is None or _entries_of(row) != _entries_due(session, phase_id, key):
        return None
    return row


def want_fresh_board(session: Session, phase_id: str, key: ScoringKey) -> None:
    """Ask for the board under a key, once, unless it is fresh or asked for."""
    if is_board_wanted(session, phase_id, key.protocol_digest, key.split_revision):
        return
    if fresh_board(session, phase_id, key) is None:
        want_board(session, phase_id, key.protocol_digest, key.split_revision)


def _entries_of(row: BoardRow) -> set[str]:
    entries = json.loads(row.body)["entries"]
    return {entry["submission_id"] for entry in entries if entry["submission_id"] is not None}


def _entries_due(session: Session, phase_id: str, key: ScoringKey) -> set[str]:
    """The latest scored submission of each (team, method), as `entries_for_board` takes them."""
    query = (
        select(Submission.team_id, Submission.method, Submission.id)
        .join(ScoreSheetRow, ScoreSheetRow.submission_id == Submission.id)
        .where(
            Submission.phase_id == phase_id,
            Submission.status == SubmissionStatus.SCORED,
            ScoreSheetRow.protocol_digest == key.protocol_digest,
            ScoreSheetRow.split_revision == key.split_revision,
        )
        .order_by(Submission.received_at, Submission.id)
    )
    latest = {(team, method): entry for team, method, entry in session.execute(query)}
    return set(latest.values())
