"""Request new boards of a phase when what they may show changed (`work.board_requests`: one)."""

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from exceptiondrive_records.boards.tables import BoardRow
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.phases.scoring_keys import is_of_key, key_of_phase, phase_and_shadow
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.work.board_requests import is_board_wanted, want_board


def renew_boards(session: Session, phase: Phase) -> None:
    """Request the board that the phase shows, and the draft of an open rescoring run."""
    keys = {key_of_phase(phase)}
    _, shadow = phase_and_shadow(session, phase.id)
    if shadow is not None:
        keys.add(shadow.key)
    for key in sorted(keys):
        want_board(session, phase.id, *key)


def renew_where_families_show(database: Database) -> int:
    """Request boards for phases whose families may be shown from now on; return how many phases."""
    with database.read() as session:
        if not any(_families_are_due(session, phase) for phase in _phases(session)):
            return 0
    with database.write() as session:
        due = [phase for phase in _phases(session) if _families_are_due(session, phase)]
        for phase in due:
            renew_boards(session, phase)
        return len(due)


def _phases(session: Session) -> list[Phase]:
    return list(session.scalars(select(Phase).order_by(Phase.id)))


def _families_are_due(session: Session, phase: Phase) -> bool:
    families_from = phase.policy.families_from
    if families_from is None or database_now(session) < families_from:
        return False
    key = key_of_phase(phase)
    if is_board_wanted(session, phase.id, *key):
        return False
    query = select(func.max(BoardRow.published_at)).where(  # runs every second: reads no board
        BoardRow.phase_id == phase.id,
        is_of_key(BoardRow, key),
        BoardRow.view == "main",
    )
    published_at = session.scalar(query)
    return published_at is not None and published_at < families_from
