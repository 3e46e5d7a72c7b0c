"""Select public protocols: those of phases and published boards, and the packaged ones.

A protocol added for a run in preparation is not public.
"""

from sqlalchemy import select, union
from sqlalchemy.orm import Session

from exceptiondrive_records.boards.tables import BoardFlip, BoardRow
from exceptiondrive_records.db.errors import NotFound
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.protocols.protocols import (
    find_protocol,
    find_protocol_row,
    list_protocols,
)
from exceptiondrive_schemas.protocol import ProtocolDocument, packaged_digests


def shown_protocols(session: Session, *, with_drafts: bool = False) -> list[ProtocolDocument]:
    """Return the public protocols, oldest first; for organizers all of them."""
    known = list_protocols(session)
    if with_drafts:
        return known
    shown = shown_digests(session)
    return [protocol for protocol in known if protocol.digest in shown]


def shown_protocol(session: Session, version_or_digest: str) -> ProtocolDocument:
    """Return a public protocol.

    Raises:
        NotFound: There is none, or it is a draft; the words are the same.
    """
    row = find_protocol_row(session, version_or_digest)
    if row.digest not in shown_digests(session):
        raise NotFound("protocol", version_or_digest)
    return find_protocol(session, row.digest)


def shown_digests(session: Session) -> frozenset[str]:
    """Return the digests of the public protocols."""
    is_seen = Phase.visibility != "hidden"
    in_force = select(Phase.protocol_digest).where(is_seen)
    ever = (
        select(BoardRow.protocol_digest)
        .join(BoardFlip, BoardFlip.board_id == BoardRow.id)
        .join(Phase, Phase.id == BoardRow.phase_id)
        .where(is_seen)
    )
    return packaged_digests() | frozenset(session.scalars(union(in_force, ever)))
