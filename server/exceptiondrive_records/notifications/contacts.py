"""Manage a team's external addresses for notifications, in addition to its inbox."""

import re
import secrets
from collections.abc import Sequence
from datetime import datetime, timedelta
from typing import Literal
from urllib.parse import urlsplit

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.people import hold_team
from exceptiondrive_records.audit.log import audit, lines_of_a_day
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.database import hold_words
from exceptiondrive_records.db.errors import Conflict, InvalidRecord, NotFound
from exceptiondrive_records.db.identifiers import random_id
from exceptiondrive_records.notifications.inbox import send_to
from exceptiondrive_records.notifications.public_addresses import is_known_private
from exceptiondrive_records.notifications.tables import (
    Channel,
    ContactPoint,
    Delivery,
    Notification,
)
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.teams.teams import require_approved
from exceptiondrive_schemas.api.notifications import NotificationView, Subscription
from exceptiondrive_schemas.base import bytes_digest

MAX_CONTACTS = 5
MAX_ADDED_A_DAY = 20
"""Each addition sends one mail to somebody who may not want it."""
MAX_CHANGED_A_DAY = 50
"""Per team, over all addresses: each change leaves an audit line forever."""
MAX_ASKED_A_DAY = 3
"""Confirmation requests to one mailbox, by all teams together."""
MAX_ASKED_BY_ONE = 2
"""Those of one team among them, so that it does not use up the limit of others."""
_EMAIL = re.compile(r"[A-Za-z0-9._%+-]{1,64}@(?:[A-Za-z0-9-]{1,63}\.)+[A-Za-z]{2,24}")


def add_contact(
    session: Session,
    team_id: int,
    channel: Channel,
    address: str,
    *,
    actor: str,
    wishes: Sequence[Subscription] = ("updates",),
) -> ContactPoint:
    """Add an address for notices to a team; a webhook gets a secret that signs its messages.

    An e-mail address gets one request for confirmation, and nothing more until its reader confirms.
    Once its reader unsubscribes by the link in a mail, no team can add it until they take that back.

    Raises:
        NotAllowed: The team is not approved yet: strangers could make the site write to anybody.
        InvalidRecord: The address cannot be used.
        Conflict: The team has it already, or reached its total or daily limit; or its reader
            unsubscribed, or got enough requests today.
    """
    require_approved(hold_team(session, team_id))
    if channel is Channel.WEBHOOK:
        _require_webhook(address)
    elif _EMAIL.fullmatch(address) is None:
        raise InvalidRecord(f"{address!r} is not an e-mail address.")
    held = list_contacts(session, team_id)
    if any(contact.address == address for contact in held):
        raise Conflict("The team is told at this address already.")
    if len(held) >= MAX_CONTACTS:
        raise Conflict(f"A team may be told at {MAX_CONTACTS} addresses; remove one first.")
    now = database_now(session)
    of_today = (ContactPoint.team_id == team_id, ContactPoint.created_at > now - timedelta(days=1))
    if (session.scalar(select(func.count()).where(*of_today)) or 0) >= MAX_ADDED_A_DAY:
        raise Conflict(f"A team may add {MAX_ADDED_A_DAY} addresses in 24 hours; go on later.")
    mailbox_digest = _mailbox_digest(address) if channel is Channel.EMAIL else None
    if mailbox_digest is not None:
        _require_may_be_asked(session, team_id, mailbox_digest, now)
    contact = ContactPoint(
        id=random_id(),
        team_id=team_id,
        channel=channel,
        address=address,
        secret=f"edw_{secrets.token_urlsafe(32)}",
        wishes=" ".join(dict.fromkeys(wishes)),
        confirmed_at=now if channel is Channel.WEBHOOK else None,
        created_at=now,
        mailbox_digest=mailbox_digest,
    )
    session.add(contact)
    session.flush()
    if channel is Channel.EMAIL:
        send_to(session, contact, _question(session, contact, now))
    detail = {"team_id": team_id, "channel": channel.value}
    audit(session, actor, "contact added", contact.id, detail)
    return contact


def set_wishes(
    session: Session, team_id: int, contact_id: str, wishes: Sequence[Subscription], *, actor: str
) -> ContactPoint:
    """Set the subscriptions of an address.

    Raises:
        NotFound: There is none, or it is another team's.
        Conflict: The team reached its daily limit of changes, or was refused.
    """
    hold_team(session, team_id)
    contact = find_contact(session, team_id, contact_id)
    wanted = " ".join(dict.fromkeys(wishes))
    if wanted == contact.wishes:
        return contact
    own = select(ContactPoint.id).where(ContactPoint.team_id == team_id)
    if lines_of_a_day(session, ["contact changed"], own) >= MAX_CHANGED_A_DAY:
        raise Conflict(
            f"A team may change what its addresses are told of {MAX_CHANGED_A_DAY} times in 24 hours; "
            "go on later."
        )
    contact.wishes = wanted
    audit(session, actor, "contact changed", contact.id, {"wishes": contact.wishes})
    return contact


def find_by_key(
    session: Session, contact_id: str, key: str, *, may_be_removed: bool = False
) -> ContactPoint:
    """Return the e-mail address to which a link in a mail belongs.

    Raises:
        NotFound: There is none, it was removed, or the key is wrong; the answer is the same.
    """
    contact = session.get(ContactPoint, contact_id)
    if (
        contact is None
        or contact.secret is None
        or not secrets.compare_digest(contact.secret.encode(), key.encode("utf-8", "replace"))
        or contact.channel is not Channel.EMAIL
        or (contact.removed_at is not None and not may_be_removed)
    ):
        ended = " that this link opens: mail to it has ended, or the link was not copied whole"
        raise NotFound("address", contact_id, ended)
    return contact


def confirm_contact(session: Session, contact_id: str, key: str) -> ContactPoint:
    """Record that the reader of an address confirmed it. Idempotent.

    Raises:
        NotFound: As `find_by_key`.
    """
    contact = find_by_key(session, contact_id, key)
    session.refresh(contact, with_for_update=True)
    if contact.confirmed_at is None:
        contact.confirmed_at = database_now(session)
        audit(session, f"contact:{contact.id}", "contact confirmed", contact.id)
    return contact


def unsubscribe_contact(session: Session, contact_id: str, key: str) -> str:
    """Unsubscribe an address, and let no team ask it again; return the address. Idempotent.

    The link works even after the team removed the address. Unanswered requests of other teams to
    the mailbox are withdrawn; confirmed addresses stay. The same link takes it back
    (`allow_contact`).

    Raises:
        NotFound: As `find_by_key`, except that the address may have been removed.
    """
    contact = find_by_key(session, contact_id, key, may_be_removed=True)
    hold_words(session, f"mailbox {contact.mailbox_digest}")
    session.refresh(contact)
    if contact.unsubscribed_at is not None:
        return contact.address
    address, now = contact.address, database_now(session)
    contact.unsubscribed_at = now
    unanswered = select(ContactPoint).where(
        ContactPoint.mailbox_digest == contact.mailbox_digest,
        ContactPoint.confirmed_at.is_(None),
        ContactPoint.removed_at.is_(None),
    )
    for each in (contact, *session.scalars(unanswered)):
        take_away(each, now)
    audit(session, f"contact:{contact.id}", "contact unsubscribed", contact.id)
    return address


def allow_contact(session: Session, contact_id: str, key: str) -> None:
    """Take back the unsubscription of a mailbox: teams may ask again, and wait for a confirmation.

    The links that unsubscribed it no longer work: each works once.

    Raises:
        NotFound: As `find_by_key`, except that the address may have been removed.
    """
    contact = find_by_key(session, contact_id, key, may_be_removed=True)
    hold_words(session, f"mailbox {contact.mailbox_digest}")
    of_mailbox = select(ContactPoint).where(ContactPoint.mailbox_digest == contact.mailbox_digest)
    for each in session.scalars(of_mailbox.where(ContactPoint.unsubscribed_at.is_not(None))):
        each.unsubscribed_at = each.secret = each.mailbox_digest = None
        audit(session, f"contact:{contact.id}", "contact allowed", each.id)


def contact_link(contact: ContactPoint, what: Literal["confirm", "unsubscribe"]) -> str:
    """Return the path, on the server, of a link in a mail."""
    return f"/contacts/{contact.id}/{what}?key={contact.secret}"


def _question(session: Session, contact: ContactPoint, now: datetime) -> NotificationView:
    team = session.get_one(Team, contact.team_id).name
    return NotificationView(
        id=random_id(),
        kind="confirm_address",
        team=team,
        phase="",
        created_at=now,
        title="Confirm that ExceptionDrive may write to this address",
        what_changed=(
            f"The team {team}, or an organizer for it, wants to be told here about its submissions.",
            "If you do not want that, do nothing: nothing more will be sent for this team.",
            "The link that ends mail to this address keeps every team from asking again, or takes it back.",
        ),
        comparison=contact_link(contact, "confirm"),
    )


def _mailbox_digest(address: str) -> str:
    """Return the digest of an address in lower case without `+tag`: a mailbox has many of these.

    Google ignores dots in names, and delivers mail for both of its hosts to one mailbox.
    """
    name, _, host = address.lower().rpartition("@")
    name = name.partition("+")[0]
    if host in ("gmail.com", "googlemail.com"):
        name, host = name.replace(".", ""), "gmail.com"
    return bytes_digest(f"{name}@{host}".encode())


def _require_may_be_asked(
    session: Session, team_id: int, mailbox_digest: str, now: datetime
) -> None:
    hold_words(session, f"mailbox {mailbox_digest}")
    asked = select(func.count()).where(ContactPoint.mailbox_digest == mailbox_digest)
    if session.scalar(asked.where(ContactPoint.unsubscribed_at.is_not(None))):
        raise Conflict(
            "Whoever reads at this address asked for no more mail; take another one, or let them take "
            "that back by the link in the mail."
        )
    today = asked.where(ContactPoint.created_at > now - timedelta(days=1))
    own = today.where(ContactPoint.team_id == team_id)
    for query, most, by in ((own, MAX_ASKED_BY_ONE, " by the team"), (today, MAX_ASKED_A_DAY, "")):
        if (session.scalar(query) or 0) >= most:
            raise Conflict(f"This address was asked {most} times in 24 hours{by}; go on later.")


def find_contact(session: Session, team_id: int, contact_id: str) -> ContactPoint:
    """Return an address of a team, confirmed or not.

    Raises:
        NotFound: There is none, or it is another team's.
    """
    contact = session.get(ContactPoint, contact_id)
    if contact is None or contact.team_id != team_id or contact.removed_at is not None:
        raise NotFound("contact", contact_id)
    return contact


def list_contacts(session: Session, team_id: int) -> list[ContactPoint]:
    """Return the addresses of a team, oldest first."""
    query = select(ContactPoint).where(
        ContactPoint.team_id == team_id, ContactPoint.removed_at.is_(None)
    )
    return list(session.scalars(query.order_by(ContactPoint.created_at, ContactPoint.id)))


def newest_delivery(session: Session, contact_id: str) -> Delivery | None:
    """Return the delivery of the newest message to an address; None if there was none yet."""
    query = (
        select(Delivery)
        .join(Notification, Notification.id == Delivery.notification_id)
        .where(Delivery.contact_id == contact_id)
        .order_by(Notification.created_at.desc(), Delivery.id)
        .limit(1)
    )
    return session.scalars(query).first()


def take_away(contact: ContactPoint, now: datetime) -> None:
    """Forget an address; a mailbox keeps its digest, and the key with which it can unsubscribe."""
    contact.address, contact.removed_at = "", now
    if contact.channel is Channel.WEBHOOK:
        contact.secret = None


def remove_contact(session: Session, team_id: int, contact_id: str, *, actor: str) -> None:
    """Remove an address of a team, and forget it.

    Raises:
        NotFound: There is none, or it is another team's.
    """
    hold_team(session, team_id)
    contact = find_contact(session, team_id, contact_id)
    take_away(contact, database_now(session))
    audit(session, actor, "contact removed", contact.id, {"team_id": team_id})


def _require_webhook(address: str) -> None:
    try:
        parts = urlsplit(address)
        host = parts.hostname
        _ = parts.port
        _ = (host or "").encode("idna")  # fails for names that cannot be resolved
    except ValueError:
        raise InvalidRecord("The webhook is not an address.") from None
    if not address.isascii() or not address.isprintable() or " " in address:
        raise InvalidRecord("A webhook address holds letters, digits and signs of ASCII alone.")
    if len(address) > 500 or not host or parts.scheme != "https":
        raise InvalidRecord("A webhook must be an https:// address of at most 500 characters.")
    if is_known_private(host):
        raise InvalidRecord(
            "A webhook must lead to a public address; this one is of a private network."
        )
    if parts.username or parts.password or parts.fragment:
        raise InvalidRecord("A webhook address may hold no user, password or fragment.")
