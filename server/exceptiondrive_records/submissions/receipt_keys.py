"""Record the public keys of receipts when a key first signs, and keep them forever."""

from sqlalchemy import select
from sqlalchemy.orm import Session

from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.submissions.tables import ReceiptKeyRow


def remember_receipt_key(session: Session, key_id: str, public_key: str) -> None:
    """Record a public key, unless it is known; a new one leaves an audit line."""
    if session.get(ReceiptKeyRow, key_id) is not None:
        return
    now = database_now(session)
    session.add(ReceiptKeyRow(key_id=key_id, public_key=public_key, first_used_at=now))
    audit(session, "server", "receipt key first used", key_id, {"public_key": public_key})


def receipt_keys(session: Session) -> list[ReceiptKeyRow]:
    """Return all public keys, oldest first."""
    query = select(ReceiptKeyRow).order_by(ReceiptKeyRow.first_used_at, ReceiptKeyRow.key_id)
    return list(session.scalars(query))
