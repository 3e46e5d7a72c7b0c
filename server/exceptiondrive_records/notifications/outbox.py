"""Send pending messages from the outbox: each is claimed by one sender, and retried for an hour."""

import threading
from functools import cache

import structlog
from sqlalchemy import Select, func, select
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session, aliased

from exceptiondrive_records.db.clock import NOW, seconds_from_now
from exceptiondrive_records.db.database import Database, reason_of
from exceptiondrive_records.notifications.channels import (
    NotDelivered,
    NoticeSettings,
    send_email,
    send_webhook,
)
from exceptiondrive_records.notifications.contacts import contact_link
from exceptiondrive_records.notifications.tables import (
    Channel,
    ContactPoint,
    Delivery,
    Notification,
)
from exceptiondrive_records.work.lease import (
    claim,
    finish,
    is_claimable,
    try_later,
    wait_before_next_s,
)
from exceptiondrive_records.work.tables import WorkState
from exceptiondrive_schemas.api.notifications import NotificationView

_log = structlog.get_logger("exceptiondrive.notices")

_LEASE_S = 180.0
"""Longer than one message takes (a mail up to a dozen replies), so that no two senders send it."""
_OF_LATE_S = 3600.0
"""The window over which sending time is shared fairly among teams."""


def run_outbox(database: Database, settings: NoticeSettings, stop: threading.Event) -> None:
    """Send due messages until `stop` is set; send none if no attempt is allowed."""
    while settings.delivery_attempts and not stop.is_set():
        try:
            is_busy = send_next(database, settings)
        except SQLAlchemyError as error:
            is_busy = False
            _log.warning("no message is sent", error=type(error).__name__, **reason_of(error))
        if not is_busy:
            stop.wait(settings.deliver_every_s)


def send_next(database: Database, settings: NoticeSettings) -> bool:
    """Send the next due message; return whether there was one.

    Teams to which sending took least time in the last hour come first, so that a slow webhook
    delays only its own team. Within a team, the message that has been due longest comes first.

    Delivery is at least once: if a process dies between sending and recording, another sends it
    again. Receivers recognize a message by the `id` in its body.
    """
    with database.read() as session:
        if session.scalar(_due()) is None:
            return False
    with database.write() as session:
        delivery = claim(session, Delivery, _due(), _LEASE_S)
        if delivery is None:
            return False
        if delivery.attempts > settings.delivery_attempts:  # sending it kills the sender
            finish(session, delivery, WorkState.FAILED, note="no sender of it came back")
            return True
        contact = session.get_one(ContactPoint, delivery.contact_id)
        body = session.get_one(Notification, delivery.notification_id).body
    try:
        _send(delivery, contact, body, settings)
        error = None
    except NotDelivered as failure:
        error = str(failure)
    except Exception as failure:  # noqa: BLE001 - one message must not block all others
        error = f"it could not be sent ({type(failure).__name__})"
    with database.write() as session:
        _record(session, delivery, error, settings)
    return True


@cache
def _due() -> Select[str]:
    of_late = aliased(Delivery)
    taken = (
        select(ContactPoint.team_id, func.sum(of_late.took_s).label("seconds"))
        .join(of_late, of_late.contact_id == ContactPoint.id)
        .where(of_late.leased_at > seconds_from_now(-_OF_LATE_S))
        .group_by(ContactPoint.team_id)
        .cte()
        .prefix_with("MATERIALIZED", dialect="postgresql")  # else evaluated for each message
    )
    return (
        select(Delivery.id)
        .join(ContactPoint, ContactPoint.id == Delivery.contact_id)
        .outerjoin(taken, taken.c.team_id == ContactPoint.team_id)
        .where(is_claimable(Delivery, NOW), ContactPoint.removed_at.is_(None))
        .order_by(func.coalesce(taken.c.seconds, 0.0), Delivery.available_at, Delivery.id)
        .limit(1)
    )


def _send(delivery: Delivery, contact: ContactPoint, body: str, settings: NoticeSettings) -> None:
    if contact.channel is Channel.EMAIL:
        notice = NotificationView.read(body)
        send_email(settings, contact.address, notice, contact_link(contact, "unsubscribe"))
        return
    assert delivery.leased_at is not None
    send_webhook(
        contact.address,
        contact.secret or "",
        body.encode("utf-8"),
        int(delivery.leased_at.timestamp()),
    )


def _record(
    session: Session, delivery: Delivery, error: str | None, settings: NoticeSettings
) -> None:
    if error is None:
        finish(session, delivery)
        return
    _log.warning("not delivered", delivery=delivery.id, attempt=delivery.attempts, reason=error)
    if delivery.attempts >= settings.delivery_attempts:
        finish(session, delivery, WorkState.FAILED, note=error)
    else:
        wait_s = wait_before_next_s(delivery, settings.delivery_backoff_s)
        try_later(session, delivery, wait_s, note=error)
