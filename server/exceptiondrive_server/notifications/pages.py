"""A team's inbox and its addresses for notifications; and the pages that links in mails open."""

from typing import Annotated, Any

from fastapi import APIRouter, Path, Query, Request
from fastapi.responses import RedirectResponse, Response
from starlette.datastructures import FormData

from exceptiondrive_records.accounts.tokens import Scope
from exceptiondrive_records.db.errors import NotFound, RecordsError
from exceptiondrive_records.notifications.contacts import (
    add_contact,
    allow_contact,
    confirm_contact,
    find_by_key,
    list_contacts,
    newest_delivery,
    remove_contact,
    set_wishes,
    unsubscribe_contact,
)
from exceptiondrive_records.notifications.inbox import (
    count_unread,
    list_notifications,
    mark_all_read,
)
from exceptiondrive_records.notifications.tables import Channel
from exceptiondrive_schemas.api.notifications import SUBSCRIPTIONS, NotificationView, Subscription
from exceptiondrive_schemas.api.rescoring import Standing
from exceptiondrive_schemas.api.standing_words import standing_words
from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_server.web.auth import ServicesOf, team_of
from exceptiondrive_server.web.browser_session import Browser, PostedForm, SignedIn, require_scope
from exceptiondrive_server.web.responses import my_page, private_page
from exceptiondrive_server.web.templating import template_filter

router = APIRouter(include_in_schema=False)
HERE = "/my/notices"
SHOWN = 50
ContactId = Annotated[str, Path(max_length=64)]
Key = Annotated[str, Query(max_length=100)]


@router.get(HERE)
def show_notices(
    browser: Browser, after: Annotated[str | None, Query(max_length=64)] = None
) -> Response:
    """Show the inbox of the team, newest first, and where it is told besides."""
    return _notices_page(browser, after=after)


@router.post(f"{HERE}/read")
def post_read(browser: Browser, form: PostedForm) -> Response:
    """Mark every message as read."""
    require_scope(browser, Scope.READ_OWN)
    with browser.services.database.write() as session:
        mark_all_read(session, team_of(browser.principal))
    return RedirectResponse(HERE, status_code=303)


@router.post(f"{HERE}/add")
def post_add(browser: Browser, form: PostedForm) -> Response:
    """Be told at another address; the secret of a webhook is shown this once."""
    require_scope(browser, Scope.SUBMIT)
    require_scope(browser, Scope.READ_OWN)
    address = str(form.get("address", "")).strip()
    channel = Channel.WEBHOOK if "://" in address else Channel.EMAIL
    try:
        with browser.services.database.write() as session:
            contact = add_contact(
                session,
                team_of(browser.principal),
                channel,
                address,
                actor=browser.principal.actor,
                wishes=_wishes(form),
            )
            secret = contact.secret if channel is Channel.WEBHOOK else None
    except RecordsError as refusal:
        return _notices_page(browser, refusal=refusal, typed=address)
    if secret is None:
        return RedirectResponse(HERE, status_code=303)
    return _notices_page(browser, secret=secret)


@router.post(f"{HERE}/{{contact_id}}/wishes")
def post_wishes(browser: Browser, form: PostedForm, contact_id: ContactId) -> Response:
    """Set what an address is told of."""
    require_scope(browser, Scope.SUBMIT)
    require_scope(browser, Scope.READ_OWN)
    who = browser.principal
    with browser.services.database.write() as session:
        set_wishes(session, team_of(who), contact_id, _wishes(form), actor=who.actor)
    return RedirectResponse(HERE, status_code=303)


@router.post(f"{HERE}/{{contact_id}}/remove")
def post_remove(browser: Browser, form: PostedForm, contact_id: ContactId) -> Response:
    """Be told no longer at an address."""
    require_scope(browser, Scope.SUBMIT)
    who = browser.principal
    with browser.services.database.write() as session:
        remove_contact(session, team_of(who), contact_id, actor=who.actor)
    return RedirectResponse(HERE, status_code=303)


@router.get("/contacts/{contact_id}/{what}")
def show_link(
    request: Request, services: ServicesOf, contact_id: ContactId, what: str, key: Key
) -> Response:
    """Ask whoever followed a link in a mail; a program that looks at links changes nothing."""
    if what not in ("confirm", "unsubscribe"):
        raise NotFound("page", what)
    with services.database.read() as session:
        contact = find_by_key(session, contact_id, key, may_be_removed=what == "unsubscribe")
    said = "unsubscribed" if contact.unsubscribed_at else what
    said = "confirmed" if said == "confirm" and contact.confirmed_at else said
    return _contact_page(request, what=said, address=contact.address, key=key, id=contact_id)


@router.post("/contacts/{contact_id}/confirm")
def post_confirm(
    request: Request, services: ServicesOf, contact_id: ContactId, key: Key
) -> Response:
    """Note the yes of whoever reads at an address."""
    with services.database.write() as session:
        address = confirm_contact(session, contact_id, key).address
    return _contact_page(request, what="confirmed", address=address)


@router.post("/contacts/{contact_id}/unsubscribe")
def post_unsubscribe(
    request: Request, services: ServicesOf, contact_id: ContactId, key: Key
) -> Response:
    """Send no more mail to an address: by one click of a mail program (RFC 8058), or by the page.

    The key in the address is all that is asked: such a program has no cookie and no form token.
    """
    with services.database.write() as session:
        address = unsubscribe_contact(session, contact_id, key)
    return _contact_page(request, what="unsubscribed", address=address, key=key, id=contact_id)


@router.post("/contacts/{contact_id}/allow")
def post_allow(request: Request, services: ServicesOf, contact_id: ContactId, key: Key) -> Response:
    """Let teams ask at an address again whose reader said no."""
    with services.database.write() as session:
        allow_contact(session, contact_id, key)
    return _contact_page(request, what="allowed", address="")


@template_filter
def stood(
    standing: Standing | None, notice: NotificationView, before: Standing | None = None
) -> str:
    """Return how an entry of a notice stood, as `standing_words` says it."""
    challenge = None if notice.challenge is None else CHALLENGES[notice.challenge]
    return standing_words(challenge, standing, before=before)


def _contact_page(request: Request, **values: Any) -> Response:
    return private_page(request, "notifications/contact.html", "", **values)


def _wishes(form: FormData) -> list[Subscription]:
    given = form.getlist("wishes")
    return [subscription for subscription in SUBSCRIPTIONS if subscription in given]


def _notices_page(
    browser: SignedIn,
    *,
    refusal: RecordsError | None = None,
    typed: str = "",
    secret: str | None = None,
    after: str | None = None,
) -> Response:
    require_scope(browser, Scope.READ_OWN)
    team_id = team_of(browser.principal)
    with browser.services.database.read() as session:
        notices = list_notifications(session, team_id, after=after, limit=SHOWN + 1)
        has_unread = count_unread(session, team_id) > 0
        contacts = [
            (contact, newest_delivery(session, contact.id))
            for contact in list_contacts(session, team_id)
        ]
    return my_page(
        browser,
        "notifications/notices.html",
        notices=notices[:SHOWN],
        following=notices[SHOWN - 1].id if len(notices) > SHOWN else None,
        has_unread=has_unread,
        contacts=contacts,
        wishes=SUBSCRIPTIONS,
        can_change=Scope.SUBMIT in browser.principal.scopes,
        refusal=refusal,
        typed=typed,
        secret=secret,
    )
