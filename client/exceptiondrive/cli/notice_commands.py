"""Commands for notices and the addresses that receive them."""

import time
from typing import TYPE_CHECKING, Annotated

from exceptiondrive.cli.completion import choices
from exceptiondrive.cli.options import argument, flag, option
from exceptiondrive.cli.output import Answer, cut_words
from exceptiondrive.cli.session import with_client
from exceptiondrive.cli.tables import notices_view, records_table
from exceptiondrive.errors import InvalidArgumentError, utc_text
from exceptiondrive_schemas.api.notifications import SUBSCRIPTIONS

if TYPE_CHECKING:
    from exceptiondrive.client import Client
    from exceptiondrive.transport import Record

MAIL_WAIT_S, MAIL_PAUSE_S = 3.0, 0.3
"""So long is the message waited for that asks to confirm an address."""
COLUMNS = ("id", "address", "last_message", "wishes", "is_confirmed", "channel", "created_at")
Subscriptions = Annotated[
    list[str] | None,
    option(
        "--tell",
        "WHAT",
        f"May be repeated: {', '.join(SUBSCRIPTIONS)}; or none.",
        offer=choices(*SUBSCRIPTIONS, "none"),
    ),
]
ContactId = Annotated[str, argument("ID", "Id, from `contacts list`.")]


@with_client
def notices(
    client: "Client",
    unread: Annotated[bool, flag("--unread", "Only unread ones.")] = False,
    read: Annotated[bool, flag("--read", "Mark what is shown as read.")] = False,
    limit: Annotated[int, option("--limit", "N", "Show at most N.", min=1)] = 20,
) -> Answer:
    """Show the team's notices, newest first."""
    found = client.notices(unread=unread, limit=limit)
    if read:
        for notice in found:
            client.mark_read(notice.id)
    return found, notices_view(found) if found else "no notices", *cut_words(found, limit)


@with_client
def list_contacts(client: "Client") -> Answer:
    """List the team's addresses, and what became of the newest message to each."""
    found = client.contacts()
    rows = [{**each, "last_message": _last_message(each)} for each in found]
    nowhere = "no addresses: the team is told in its inbox alone"
    return found, records_table(rows, COLUMNS) if found else nowhere


@with_client
def add(
    client: "Client",
    address: Annotated[str, argument("ADDRESS", "E-mail address, or https of a webhook.")],
    tell: Subscriptions = None,
) -> Answer:
    """Add an address for notices, of protocol updates unless --tell says otherwise.

    The owner of an e-mail address has to confirm it. The secret of a webhook is shown once.
    """
    contact = client.add_contact(address, _parse_subscriptions(tell) or ("updates",))
    words = (
        f"secret, shown this once: {contact['secret']}"
        if contact.get("secret")
        else _confirmation_sentence(client, contact["id"])
    )
    return contact, f"{contact['id']}  {contact['address']}  {words}"


@with_client
def tell(
    client: "Client",
    contact_id: ContactId,
    what: Annotated[
        list[str],
        argument(
            "WHAT...",
            f"{', '.join(SUBSCRIPTIONS)}; or none.",
            offer=choices(*SUBSCRIPTIONS, "none"),
        ),
    ],
) -> Answer:
    """Choose which notices an address gets."""
    contact = client.set_wishes(contact_id, _parse_subscriptions(what))
    told = ", ".join(contact["wishes"]) or "nothing"
    return contact, f"{contact['address']} is told of: {told}"


@with_client
def remove(client: "Client", contact_id: ContactId) -> Answer:
    """Remove an address: it gets no more notices."""
    contact = client.remove_contact(contact_id)
    return contact, f"{contact['address']} is told nothing more"


def _last_message(contact: "Record") -> str:
    last = contact["last_message"] or {}
    state = last.get("state", "").replace("_", " ")
    return f"{state} {utc_text(last['sent_at'])}" if last.get("sent_at") else state


def _confirmation_sentence(client: "Client", contact_id: str) -> str:
    """Say what became of the message that asks to confirm an address, which is sent at once."""
    until = time.monotonic() + MAIL_WAIT_S
    while True:
        found = next((each for each in client.contacts() if each["id"] == contact_id), {})
        last = found.get("last_message") or {}
        if last.get("state") == "sent":
            return "confirm it by the link that was sent there"
        if last.get("attempts"):
            return (
                "the link to confirm it could not be sent: this server may have no mail server; ask "
                "the organizers. `exceptiondrive contacts list` says when it was sent"
            )
        if time.monotonic() > until:
            return "confirm it by the link that is sent there"
        time.sleep(MAIL_PAUSE_S)


def _parse_subscriptions(given: list[str] | None) -> tuple[str, ...]:
    wanted = tuple(each for each in given or () if each != "none")
    unknown = [each for each in wanted if each not in SUBSCRIPTIONS]
    if unknown:
        raise InvalidArgumentError(
            "wrong_option", f"{unknown[0]!r} is none of {', '.join(SUBSCRIPTIONS)}."
        )
    return wanted


contacts = {"list": list_contacts, "add": add, "tell": tell, "remove": remove}
