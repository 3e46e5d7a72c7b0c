"""The outbox: what waits to be sent, one leader sending it, each message tried for hours."""

import os
import socket
import threading
from dataclasses import dataclass
from datetime import timedelta

import structlog
from sqlalchemy import select
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.db.identifiers import random_id
from exceptiondrive_records.notifications.channels import NotDelivered, send_email, send_webhook
from exceptiondrive_records.notifications.settings import NoticeSettings
from exceptiondrive_records.notifications.tables import (
    Channel,
    ContactPoint,
    Delivery,
    DeliveryState,
    Notification,
)
from exceptiondrive_records.work.reconciler import give_up_lead, take_lead
from exceptiondrive_schemas.rescoring import NotificationView

_log = structlog.get_logger("exceptiondrive.notices")

LEADERSHIP = "notices"
_LEASE_S = 60.0
"""Longer than one message may take: two senders would send it twice."""


@dataclass(frozen=True)
class Parcel:
    """A message that is due, and where it goes."""

    delivery_id: str
    channel: Channel
    address: str
    secret: str | None
    body: bytes
    timestamp: int


def run_outbox(database: Database, settings: NoticeSettings, stop: threading.Event) -> None:
    """Send what is due while leading, until `stop` is set."""
    holder = f"{socket.gethostname()}:{os.getpid()}:{random_id(6)}"
    while not stop.is_set():
        try:
            is_busy = _leads(database, holder) and send_next(database, settings)
        except SQLAlchemyError as error:
            is_busy = False
            _log.warning("the database did not answer", error=type(error).__name__)
        if not is_busy:
            stop.wait(settings.deliver_every_s)
    with database.write() as session:
        give_up_lead(session, LEADERSHIP, holder)


def send_next(database: Database, settings: NoticeSettings) -> bool:
    """Send the message that is due longest; return whether there was one.

    A process that dies between sending and recording sends again: receivers know a message by
    the `id` in its body.
    """
    with database.read() as session:
        parcel = _next(session)
    if parcel is None:
        return False
    try:
        _send(parcel, settings)
        error = None
    except NotDelivered as failure:
        error = str(failure)
    except Exception as failure:  # noqa: BLE001 - one message must not keep all others waiting
        error = f"it could not be sent ({type(failure).__name__})"
    with database.write() as session:
        _record(session, parcel, error, settings)
    return True


def _leads(database: Database, holder: str) -> bool:
    with database.write() as session:
        return take_lead(session, LEADERSHIP, holder, _LEASE_S)


def _next(session: Session) -> Parcel | None:
    now = database_now(session)
    query = (
        select(Delivery, ContactPoint, Notification)
        .join(ContactPoint, ContactPoint.id == Delivery.contact_id)
        .join(Notification, Notification.id == Delivery.notification_id)
        .where(
            Delivery.state == DeliveryState.WAITING,
            Delivery.available_at <= now,
            ContactPoint.removed_at.is_(None),
        )
        .order_by(Delivery.available_at, Delivery.id)
        .limit(1)
    )
    found = session.execute(query).first()
    if found is None:
        return None
    delivery, contact, notice = found
    return Parcel(
        delivery_id=delivery.id,
        channel=contact.channel,
        address=contact.address,
        secret=contact.secret,
        body=notice.body.encode("utf-8"),
        timestamp=int(now.timestamp()),
    )


def _send(parcel: Parcel, settings: NoticeSettings) -> None:
    if parcel.channel is Channel.EMAIL:
        notice = NotificationView.model_validate_json(parcel.body)
        send_email(settings, parcel.address, notice)
        return
    send_webhook(
        parcel.address,
        parcel.secret or "",
        parcel.body,
        parcel.timestamp,
        may_be_private=settings.webhooks_may_be_private,
    )


def _record(session: Session, parcel: Parcel, error: str | None, settings: NoticeSettings) -> None:
    delivery = session.get_one(Delivery, parcel.delivery_id, with_for_update=True)
    now = database_now(session)
    delivery.attempts += 1
    delivery.last_error = error
    if error is None:
        delivery.state, delivery.sent_at = DeliveryState.SENT, now
        return
    if delivery.attempts >= settings.delivery_attempts:
        delivery.state = DeliveryState.GIVEN_UP
    wait_s = settings.delivery_backoff_s * 2 ** (delivery.attempts - 1)
    delivery.available_at = now + timedelta(seconds=wait_s)
    _log.warning("not delivered", delivery=delivery.id, attempt=delivery.attempts, reason=error)
