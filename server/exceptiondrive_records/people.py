"""People whom an OpenID provider vouches for, and who of them is an organizer."""

from dataclasses import dataclass

from sqlalchemy import select
from sqlalchemy.orm import Session

from exceptiondrive_records.audit import audit
from exceptiondrive_records.clock import database_now
from exceptiondrive_records.errors import InvalidRecord, NotFound
from exceptiondrive_records.identifiers import checked_text, random_id
from exceptiondrive_records.tables_people import Person
from exceptiondrive_records.upserts import insert_if_absent

MAX_NAME = 80
MAX_SUBJECT = 255
"""The longest that OpenID Connect allows."""


@dataclass(frozen=True)
class Identity:
    """Who signed in, as the provider says it."""

    issuer: str
    subject: str
    name: str | None = None
    email: str | None = None


def welcome_person(session: Session, identity: Identity) -> Person:
    """Return the person of an identity, made at the first sign-in; name and email are renewed.

    Issuer and subject decide, nothing else: an email address may change hands.

    Raises:
        InvalidRecord: The provider's subject cannot be used.
    """
    if not 0 < len(identity.subject) <= MAX_SUBJECT:
        raise InvalidRecord("The provider named nobody.")
    now = database_now(session)
    insert_if_absent(
        session,
        Person,
        id=random_id(),
        issuer=identity.issuer,
        subject=identity.subject,
        name="",
        email=None,
        is_organizer=False,
        created_at=now,
        signed_in_at=now,
    )
    query = select(Person).where(
        Person.issuer == identity.issuer, Person.subject == identity.subject
    )
    person = session.scalars(query.with_for_update()).one()
    person.name = _fit(identity.name) or person.name or f"Person {person.id[:6]}"
    person.email = _fit(identity.email)
    person.signed_in_at = now
    return person


def list_people(session: Session) -> list[Person]:
    """Return everybody who ever signed in through the provider, by name."""
    return list(session.scalars(select(Person).order_by(Person.name, Person.id)))


def find_person(session: Session, person_id: str) -> Person:
    """Return a person.

    Raises:
        NotFound: There is none with this id.
    """
    person = session.get(Person, person_id)
    if person is None:
        raise NotFound("person", person_id)
    return person


def set_organizer(session: Session, person_id: str, is_organizer: bool, *, actor: str) -> Person:
    """Make a person an organizer, or no longer; it counts from the next request on.

    Raises:
        NotFound: There is none with this id.
    """
    person = find_person(session, person_id)
    if person.is_organizer != is_organizer:
        person.is_organizer = is_organizer
        audit(session, actor, "organizer granted" if is_organizer else "organizer ended", person_id)
    return person


def _fit(text: str | None) -> str | None:
    """Return a provider's text if it can be shown safely: a bad name is no reason to refuse."""
    if text is None:
        return None
    try:
        return checked_text("name", text[:MAX_NAME], max_length=MAX_NAME)
    except InvalidRecord:
        return None
