"""Where a team wants to be told besides its inbox."""

import re
import secrets
from urllib.parse import urlsplit

from sqlalchemy import select
from sqlalchemy.orm import Session

from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import Conflict, InvalidRecord, NotFound
from exceptiondrive_records.db.identifiers import random_id
from exceptiondrive_records.notifications.channels import is_known_private
from exceptiondrive_records.notifications.tables import (
    Channel,
    ContactPoint,
    Delivery,
    Notification,
)

MAX_CONTACTS = 5
_EMAIL = re.compile(r"[A-Za-z0-9._%+-]{1,64}@(?:[A-Za-z0-9-]{1,63}\.)+[A-Za-z]{2,24}")
_LOOPBACK = ("localhost", "127.0.0.1", "::1")


def add_contact(
    session: Session,
    team_id: int,
    channel: Channel,
    address: str,
    *,
    actor: str,
    may_be_private: bool = False,
) -> ContactPoint:
    """Let a team be told at an address; a webhook gets a secret that signs what is sent.

    Args:
        session: Of a write transaction.
        team_id: The team.
        channel: Webhook or e-mail.
        address: https address, or e-mail address.
        actor: Who.
        may_be_private: Whether http to this very machine is let through, for tests.

    Raises:
        InvalidRecord: The address cannot be used.
        Conflict: The team has it already, or has enough.
    """
    if channel is Channel.WEBHOOK:
        _require_webhook(address, may_be_private)
    elif _EMAIL.fullmatch(address) is None:
        raise InvalidRecord(f"{address!r} is not an e-mail address.")
    held = list_contacts(session, team_id)
    if any(contact.address == address for contact in held):
        raise Conflict("The team is told at this address already.")
    if len(held) >= MAX_CONTACTS:
        raise Conflict(f"A team may be told at {MAX_CONTACTS} addresses; remove one first.")
    contact = ContactPoint(
        id=random_id(),
        team_id=team_id,
        channel=channel,
        address=address,
        secret=f"edw_{secrets.token_urlsafe(32)}" if channel is Channel.WEBHOOK else None,
        created_at=database_now(session),
    )
    session.add(contact)
    session.flush()
    detail = {"team_id": team_id, "channel": channel.value}
    audit(session, actor, "contact added", contact.id, detail)
    return contact


def list_contacts(session: Session, team_id: int) -> list[ContactPoint]:
    """Return the addresses of a team, oldest first."""
    query = select(ContactPoint).where(
        ContactPoint.team_id == team_id, ContactPoint.removed_at.is_(None)
    )
    return list(session.scalars(query.order_by(ContactPoint.created_at, ContactPoint.id)))


def newest_delivery(session: Session, contact_id: str) -> Delivery | None:
    """Return what became of the newest message to an address; None: there was none yet."""
    query = (
        select(Delivery)
        .join(Notification, Notification.id == Delivery.notification_id)
        .where(Delivery.contact_id == contact_id)
        .order_by(Notification.created_at.desc(), Delivery.id)
        .limit(1)
    )
    return session.scalars(query).first()


def remove_contact(session: Session, team_id: int, contact_id: str, *, actor: str) -> ContactPoint:
    """Tell a team no longer at an address.

    Raises:
        NotFound: There is none, or it is another team's.
    """
    contact = session.get(ContactPoint, contact_id)
    if contact is None or contact.team_id != team_id or contact.removed_at is not None:
        raise NotFound("contact", contact_id)
    contact.removed_at = database_now(session)
    audit(session, actor, "contact removed", contact.id, {"team_id": team_id})
    return contact


def _require_webhook(address: str, may_be_private: bool) -> None:
    try:
        parts = urlsplit(address)
        host = parts.hostname
        _ = parts.port
        _ = (host or "").encode("idna")  # what no resolver takes
    except ValueError:
        raise InvalidRecord("The webhook is not an address.") from None
    if not address.isascii() or not address.isprintable() or " " in address:
        raise InvalidRecord("A webhook address holds letters, digits and signs of ASCII alone.")
    is_local = may_be_private and parts.scheme == "http" and host in _LOOPBACK
    if len(address) > 500 or not host or (parts.scheme != "https" and not is_local):
        raise InvalidRecord("A webhook must be an https:// address of at most 500 characters.")
    if is_known_private(host) and not is_local:
        raise InvalidRecord(
            "A webhook must lead to a public address; this one is of a private network."
        )
    if parts.username or parts.password or parts.fragment:
        raise InvalidRecord("A webhook address may hold no user, password or fragment.")
