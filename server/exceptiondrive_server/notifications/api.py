"""A team's notifications: its inbox, webhooks and e-mail addresses."""

from datetime import datetime
from typing import Annotated

from fastapi import APIRouter, Path, Query, Response
from pydantic import BaseModel, Field
from sqlalchemy.orm import Session

from exceptiondrive_records.notifications.contacts import (
    add_contact,
    find_contact,
    list_contacts,
    newest_delivery,
    remove_contact,
    set_wishes,
)
from exceptiondrive_records.notifications.inbox import list_notifications, mark_read
from exceptiondrive_records.notifications.tables import Channel, ContactPoint, DeliveryState
from exceptiondrive_records.work.tables import WorkState
from exceptiondrive_schemas.api.notifications import SUBSCRIPTIONS, NotificationView, Subscription
from exceptiondrive_schemas.api.problems import ProblemCode
from exceptiondrive_server.web.auth import Reader, ServicesOf, Submitter, team_of
from exceptiondrive_server.web.forms import Form
from exceptiondrive_server.web.problems import problem_responses

router = APIRouter(
    tags=["notifications"],
    responses=problem_responses(
        ProblemCode.NOT_SIGNED_IN,
        ProblemCode.NOT_ALLOWED,
        ProblemCode.NOT_FOUND,
        ProblemCode.CONFLICT,
    ),
)

_LOCATION = {"description": "Where it is changed and removed.", "schema": {"type": "string"}}
webhooks = APIRouter(tags=["notifications"])
"""What we send ourselves: described, and served nowhere."""


class NewContact(Form):
    """An address to be told at."""

    channel: Channel
    address: Annotated[str, Field(min_length=3, max_length=500)]
    """An e-mail address, or the https address of a webhook."""
    wishes: tuple[Subscription, ...] = ("updates",)
    """What it subscribes to."""


class Subscriptions(Form):
    """What an address subscribes to from now on."""

    wishes: tuple[Subscription, ...]


class LastMessage(BaseModel):
    """What became of the newest message to an address; why it failed stays with the operators."""

    state: DeliveryState
    attempts: int
    """Those that have ended: one under way has failed nowhere yet."""
    sent_at: datetime | None


class ContactView(BaseModel):
    """An address that a team is told at; the secret is shown when it is added, and never again."""

    id: str
    channel: Channel
    address: str
    created_at: datetime
    wishes: tuple[Subscription, ...]
    is_confirmed: bool
    """Whether whoever reads there said yes; an e-mail address is told nothing before."""
    secret: str | None = None
    """Signs what a webhook is sent; told once, in the answer to its making."""
    last_message: LastMessage | None = None
    """None: it was sent none yet."""


@router.get("/notifications", operation_id="listNotifications")
def get_notifications(
    services: ServicesOf,
    reader: Reader,
    unread: Annotated[bool, Query(description="only what was not read yet")] = False,
    limit: Annotated[int, Query(ge=1, le=500, description="how many at most")] = 100,
    after: Annotated[
        str | None, Query(max_length=64, description="id of the last message of a page")
    ] = None,
) -> list[NotificationView]:
    """Read the team's inbox, newest first; messages about protocol updates hold old and new numbers."""
    with services.database.read() as session:
        return list_notifications(
            session, team_of(reader), only_unread=unread, after=after, limit=limit
        )


@router.post("/notifications/{notification_id}/read", operation_id="markNotificationRead")
def post_read(
    services: ServicesOf, reader: Reader, notification_id: Annotated[str, Path(max_length=64)]
) -> NotificationView:
    """Mark a message as read."""
    with services.database.write() as session:
        return mark_read(session, team_of(reader), notification_id)


@router.get("/contacts", operation_id="listContacts")
def get_contacts(services: ServicesOf, reader: Reader) -> list[ContactView]:
    """List the team's addresses for notifications, besides its inbox."""
    with services.database.read() as session:
        contacts = list_contacts(session, team_of(reader))
        return [_with_last_message(session, contact) for contact in contacts]


@router.post(
    "/contacts",
    operation_id="addContact",
    status_code=201,
    responses={201: {"headers": {"Location": _LOCATION}}},
)
def post_contact(
    response: Response, services: ServicesOf, submitter: Submitter, _: Reader, wanted: NewContact
) -> ContactView:
    """Add a webhook or e-mail address for notifications; a webhook's secret is shown only in this response.

    It needs both scopes, `submit` and `read:own`, since notifications contain scores and ranks. An e-mail address
    gets one message that asks for confirmation, and nothing more until it is confirmed.

    A webhook receives a NotificationView as JSON by POST, with the headers `ExceptionDrive-Timestamp`, the
    Unix time in seconds, and `ExceptionDrive-Signature`: `sha256=` and the hex HMAC-SHA256 of timestamp, full
    stop and body, keyed with the whole secret, including its `edw_`. Refuse messages that are older than some
    minutes or whose signature differs; deduplicate by `id`, since a message may come twice. Any status from 200
    to 299 acknowledges it; redirects are not followed, and failed deliveries are retried for about an hour.
    """
    with services.database.write() as session:
        contact = add_contact(
            session,
            team_of(submitter),
            wanted.channel,
            wanted.address,
            actor=submitter.actor,
            wishes=wanted.wishes,
        )
        response.headers["Location"] = f"/api/v1/contacts/{contact.id}"
        secret = contact.secret if contact.channel is Channel.WEBHOOK else None
        return _view(contact).model_copy(update={"secret": secret})


@router.patch("/contacts/{contact_id}", operation_id="setWishes")
def patch_contact(
    services: ServicesOf,
    submitter: Submitter,
    _: Reader,
    contact_id: Annotated[str, Path(max_length=64)],
    wanted: Subscriptions,
) -> ContactView:
    """Set what an address subscribes to: protocol updates, scored, failed, overtaken, a phase that ends."""
    with services.database.write() as session:
        team_id, actor = team_of(submitter), submitter.actor
        return _view(set_wishes(session, team_id, contact_id, wanted.wishes, actor=actor))


@router.post("/contacts/{contact_id}/remove", operation_id="removeContact")
def post_remove(
    services: ServicesOf, submitter: Submitter, contact_id: Annotated[str, Path(max_length=64)]
) -> ContactView:
    """Remove an address; apart from this response, it is forgotten."""
    with services.database.write() as session:
        removed = _view(find_contact(session, team_of(submitter), contact_id))
        remove_contact(session, team_of(submitter), contact_id, actor=submitter.actor)
        return removed


def _with_last_message(session: Session, contact: ContactPoint) -> ContactView:
    found = newest_delivery(session, contact.id)
    if found is None:
        return _view(contact)
    sent_at = found.finished_at if found.outcome is DeliveryState.SENT else None
    n_ended = found.attempts - (found.state is WorkState.LEASED)
    last = LastMessage(state=found.outcome, attempts=n_ended, sent_at=sent_at)
    return _view(contact).model_copy(update={"last_message": last})


def _view(contact: ContactPoint) -> ContactView:
    return ContactView(
        id=contact.id,
        channel=contact.channel,
        address=contact.address,
        created_at=contact.created_at,
        wishes=tuple(
            subscription for subscription in SUBSCRIPTIONS if subscription in contact.wishes.split()
        ),
        is_confirmed=contact.confirmed_at is not None,
    )


def _header(name: str, schema: dict[str, str], words: str) -> dict[str, object]:
    return {"name": name, "in": "header", "required": True, "description": words, "schema": schema}


@webhooks.post(
    "notification",
    operation_id="notification",
    status_code=204,
    responses={204: {"description": "Taken, as by any status from 200 to 299."}},
    openapi_extra={
        "parameters": [
            _header(
                "ExceptionDrive-Timestamp",
                {"type": "integer"},
                "Unix time of the sending, in seconds",
            ),
            _header(
                "ExceptionDrive-Signature",
                {"type": "string", "pattern": "^sha256=[0-9a-f]{64}$"},
                "HMAC-SHA256 of timestamp, full stop and body under the secret of `addContact`",
            ),
        ],
        "requestBody": {
            "required": True,
            "content": {
                "application/json": {"schema": {"$ref": "#/components/schemas/NotificationView"}}
            },
        },
    },
)
def notification() -> None:
    """A notification, sent to each webhook of the team as `addContact` describes."""
