"""Under which protocol an upload was accepted: what was accepted once is read the same for ever."""

from sqlalchemy import select
from sqlalchemy.orm import Session

from exceptiondrive_records.protocols import find_protocol
from exceptiondrive_records.tables import ScoreSheetRow
from exceptiondrive_schemas.protocol import Protocol


def accepted_under(session: Session, submission_id: str) -> Protocol | None:
    """Return the protocol of the first sheet of a submission; None while it has none."""
    query = (
        select(ScoreSheetRow.protocol_digest)
        .where(ScoreSheetRow.submission_id == submission_id)
        .order_by(ScoreSheetRow.created_at, ScoreSheetRow.protocol_digest)
        .limit(1)
    )
    digest = session.scalars(query).first()
    return None if digest is None else find_protocol(session, digest)
