"""Requests for boards: a counter of what is wanted against what was built."""

from sqlalchemy.dialects.postgresql import insert as postgres_insert
from sqlalchemy.dialects.sqlite import insert as sqlite_insert
from sqlalchemy.orm import Session

from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.work.tables import BoardRequest


def want_board(
    session: Session, phase_id: str, protocol_digest: str, split_revision: str | None = None
) -> None:
    """Ask, in this transaction, for a new board of the phase under a protocol.

    Args:
        session: Of a write transaction.
        phase_id: Of the phase.
        protocol_digest: Under which its entries are ranked.
        split_revision: Against which they were scored; by default the one the phase shows.
    """
    if split_revision is None:
        split_revision = session.get_one(Phase, phase_id).split_revision
    insert = sqlite_insert if session.get_bind().dialect.name == "sqlite" else postgres_insert
    session.execute(
        insert(BoardRequest)
        .values(
            phase_id=phase_id,
            protocol_digest=protocol_digest,
            split_revision=split_revision,
            wanted=1,
            built=0,
            fence=0,
        )
        .on_conflict_do_update(
            index_elements=["phase_id", "protocol_digest", "split_revision"],
            set_={"wanted": BoardRequest.wanted + 1},
        )
    )
