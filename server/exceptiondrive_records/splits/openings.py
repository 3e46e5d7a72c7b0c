"""Record the protocols under which workers opened a withheld split: each reveals more of it."""

from sqlalchemy import bindparam, select
from sqlalchemy.orm import Session

from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.splits.tables import SplitOpening

_PROTOCOLS = select(SplitOpening.protocol_digest).where(
    SplitOpening.split_name == bindparam("split")
)


def opened_protocols(session: Session, split_name: str) -> set[str]:
    """Return the digests of the protocols that a split was opened under, at any revision."""
    return set(session.scalars(_PROTOCOLS, {"split": split_name}))


def count_opening(session: Session, split_name: str, protocol_digest: str) -> None:
    """Record a protocol before a split is first opened under it; the caller has locked the split."""
    opened_at = database_now(session)
    session.add(
        SplitOpening(split_name=split_name, protocol_digest=protocol_digest, opened_at=opened_at)
    )
