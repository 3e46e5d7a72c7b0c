"""Store confirmations signed by organizers; only workers rely on them, and verify them again."""

import base64

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from sqlalchemy import bindparam, select
from sqlalchemy.orm import Session

from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.database import find_row
from exceptiondrive_records.db.errors import Conflict, InvalidRecord, NotFound
from exceptiondrive_records.protocols.tables import ProtocolRow
from exceptiondrive_records.splits.splits import find_split
from exceptiondrive_records.splits.tables import ConfirmationRow
from exceptiondrive_schemas.api.confirmation import Confirmation, confirmed_bytes
from exceptiondrive_schemas.split import SplitRef

_CONFIRMATIONS = select(ConfirmationRow.confirmation).where(
    ConfirmationRow.split_name == bindparam("name"),
    ConfirmationRow.split_revision == bindparam("revision"),
    ConfirmationRow.protocol_digest == bindparam("protocol"),
    ConfirmationRow.withdrawn_at.is_(None),
)


def add_confirmation(session: Session, given: Confirmation, actor: str) -> ConfirmationRow:
    """Store a confirmation. Idempotent.

    Raises:
        NotFound: The split revision is not registered, or there is no such protocol.
        InvalidRecord: The signature does not match split, protocol and key.
        Conflict: The confirmation of this key was withdrawn.
    """
    find_split(session, given.split.name, given.split.revision)
    protocol = find_row(session, ProtocolRow, "protocol", given.protocol)
    if not is_signed(given):
        raise InvalidRecord("The signature does not match this split, protocol and key.")
    known = session.get(ConfirmationRow, given.id)
    if known is not None and known.withdrawn_at is not None:
        raise Conflict(
            "This confirmation was withdrawn, so its key never counts again for the same split "
            "revision and protocol: sign with another key that the operator has named."
        )
    if known is not None:
        return known
    row = ConfirmationRow(
        id=given.id,
        split_name=given.split.name,
        split_revision=given.split.revision,
        protocol_digest=given.protocol,
        confirmation=given,
        confirmed_at=database_now(session),
    )
    session.add(row)
    session.flush()
    detail = {"protocol": protocol.version, **given.split.model_dump(), "key": given.public_key}
    audit(session, actor, "protocol confirmed", given.split.name, detail)
    return row


def withdraw_confirmation(session: Session, confirmation_id: str, reason: str, actor: str) -> None:
    """Withdraw a confirmation: workers no longer score or publish what required it.

    Raises:
        NotFound: There is none with this id, or it is withdrawn already.
    """
    row = session.get(
        ConfirmationRow, confirmation_id, with_for_update=True, populate_existing=True
    )
    if row is None or row.withdrawn_at is not None:
        raise NotFound("confirmation", confirmation_id)
    row.withdrawn_at = database_now(session)
    detail = {"protocol": row.protocol_digest, "revision": row.split_revision, "reason": reason}
    audit(session, actor, "confirmation withdrawn", row.split_name, detail)


def list_confirmations(session: Session) -> list[ConfirmationRow]:
    """Return all confirmations that were not withdrawn, newest first."""
    query = select(ConfirmationRow).where(ConfirmationRow.withdrawn_at.is_(None))
    order = (ConfirmationRow.confirmed_at.desc(), ConfirmationRow.id)
    return list(session.scalars(query.order_by(*order)))


def keys_that_confirm(session: Session, split: SplitRef, protocol_digest: str) -> set[str]:
    """Return the public keys with a valid confirmation that was not withdrawn."""
    given = {"name": split.name, "revision": split.revision, "protocol": protocol_digest}
    found = session.scalars(_CONFIRMATIONS, given).all()
    return {
        each.public_key
        for each in found
        if (each.split, each.protocol) == (split, protocol_digest) and is_signed(each)
    }


def is_signed(given: Confirmation) -> bool:
    """Whether the signature is valid for this split, protocol and key."""
    try:
        key = Ed25519PublicKey.from_public_bytes(base64.b64decode(given.public_key, validate=True))
        signature = base64.b64decode(given.signature, validate=True)
        key.verify(signature, confirmed_bytes(given.split, given.protocol))
    except (InvalidSignature, ValueError):
        return False
    return True
