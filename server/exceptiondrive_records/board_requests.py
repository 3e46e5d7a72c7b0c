"""Requests for boards: a counter of what is wanted against what was built."""

from sqlalchemy.dialects.postgresql import insert as postgres_insert
from sqlalchemy.dialects.sqlite import insert as sqlite_insert
from sqlalchemy.orm import Session

from exceptiondrive_records.tables import BoardRequest


def want_board(session: Session, phase_id: str, protocol_digest: str) -> None:
    """Ask, in this transaction, for a new board of the phase under a protocol."""
    insert = sqlite_insert if session.get_bind().dialect.name == "sqlite" else postgres_insert
    session.execute(
        insert(BoardRequest)
        .values(phase_id=phase_id, protocol_digest=protocol_digest, wanted=1, built=0, fence=0)
        .on_conflict_do_update(
            index_elements=["phase_id", "protocol_digest"],
            set_={"wanted": BoardRequest.wanted + 1, "rung_at": None},
        )
    )
