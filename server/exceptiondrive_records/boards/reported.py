"""External boards that an organizer puts beside a phase: reported rows, which never rank."""

from sqlalchemy import select
from sqlalchemy.orm import Session

from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.boards.boards import current_board, parsed_board
from exceptiondrive_records.boards.reported_files import MAX_CITE, read_rows
from exceptiondrive_records.boards.tables import ReportedBoard
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import Conflict, NotFound
from exceptiondrive_records.db.identifiers import checked_reason, checked_text, random_id
from exceptiondrive_records.phases.phases import lock_phase
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.protocols.protocols import find_protocol
from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_schemas.reported.imported import ImportedRows, Measured
from exceptiondrive_schemas.split import SplitRef

MAX_TITLE = 120
MAX_FILE = 500_000
"""The maximum size of an imported file in characters."""


def import_board(
    session: Session, phase_id: str, title: str, cite: str, file: str, *, actor: str
) -> ReportedBoard:
    """Import the rows of an external board beside a phase: all of them, or none.

    `cite` is an address or a citation, `file` a text in the format of `read_rows`.

    Raises:
        NotFound: No such phase.
        InvalidRecord: A text cannot be used, or rows are refused: each is named.
        Conflict: The same rows are beside the phase already.
    """
    phase = lock_phase(session, phase_id)
    title = checked_text("title", title, max_length=MAX_TITLE)
    cite = checked_text("source", cite, max_length=MAX_CITE)
    rows = ImportedRows(rows=read_rows(file, CHALLENGES[phase.challenge]))
    for other in reported_boards(session, phase.id):
        if other.rows == rows:
            raise Conflict(f"These rows stand beside the phase already, as {other.title!r}.")
    row = ReportedBoard(
        id=random_id(),
        phase_id=phase.id,
        title=title,
        cite=cite,
        rows=rows,
        imported_at=database_now(session),
        withdrawn_at=None,
    )
    session.add(row)
    session.flush()
    detail = {"phase": phase.id, "title": title, "cite": cite, "rows": len(rows.rows)}
    audit(session, actor, "reported board imported", row.id, detail)
    return row


def withdraw_reported_board(
    session: Session, phase_id: str, reported_id: str, *, reason: str, actor: str
) -> ReportedBoard:
    """Withdraw the rows of an external board from a phase; they can be imported again.

    Raises:
        NotFound: The phase has no external board with this id.
        InvalidRecord: The reason is empty.
        Conflict: They are withdrawn already.
    """
    row = find_reported_board(session, phase_id, reported_id, lock=True)
    reason = checked_reason(reason)
    if row.withdrawn_at is not None:
        raise Conflict("These rows are withdrawn already.")
    row.withdrawn_at = database_now(session)
    detail = {"phase": phase_id, "title": row.title, "reason": reason}
    audit(session, actor, "reported board withdrawn", row.id, detail)
    return row


def find_reported_board(
    session: Session, phase_id: str, reported_id: str, *, lock: bool = False
) -> ReportedBoard:
    """Return an imported board of a phase.

    Raises:
        NotFound: The phase has no external board with this id.
    """
    row = session.get(ReportedBoard, reported_id, with_for_update=lock, populate_existing=lock)
    if row is None or row.phase_id != phase_id:
        raise NotFound("reported board", reported_id)
    return row


def reported_boards(
    session: Session, phase_id: str, *, with_withdrawn: bool = False
) -> list[ReportedBoard]:
    """Return the imported boards of a phase, newest first."""
    query = select(ReportedBoard).where(ReportedBoard.phase_id == phase_id)
    if not with_withdrawn:
        query = query.where(ReportedBoard.withdrawn_at.is_(None))
    return list(session.scalars(query.order_by(ReportedBoard.imported_at.desc(), ReportedBoard.id)))


def measured_on(session: Session, phase: Phase) -> Measured:
    """Return the protocol and samples that a phase shows, for comparison with reported rows."""
    board = current_board(session, phase.id)
    if board is not None:
        return Measured.on(parsed_board(board))
    protocol = find_protocol(session, phase.protocol_digest)
    return Measured(
        split=SplitRef(name=phase.split_name, revision=phase.split_revision),
        protocol=protocol.version,
        protocol_digest=protocol.digest,
        average=protocol.grading.headline,
    )
