"""Sessions of browsers: a random secret in a cookie, its digest here, the rights of a token."""

import hashlib
import secrets
from datetime import timedelta

from sqlalchemy import delete, select, update
from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.people import is_member, teams_of
from exceptiondrive_records.accounts.tables import PageSession, Person, PersonSession, Token
from exceptiondrive_records.accounts.tokens import (
    ORGANIZER_SCOPES,
    TEAM_SCOPES,
    Principal,
    principal_of,
)
from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import NotAllowed
from exceptiondrive_records.teams.tables import Team

LIFETIME = timedelta(hours=12)
MAX_SECRET_LENGTH = 100


def open_page_session(session: Session, principal: Principal) -> str:
    """Open a session with the rights of a token; its secret is returned here and never again.

    Sessions that have run out are removed on the way.
    """
    now = database_now(session)
    session.execute(delete(PageSession).where(PageSession.expires_at <= now))
    secret = new_secret()
    session.add(
        PageSession(
            secret_digest=secret_digest(secret),
            token_id=principal.token_id,
            created_at=now,
            expires_at=now + LIFETIME,
        )
    )
    audit(session, principal.actor, "signed in", principal.token_id)
    return secret


def find_page_session(session: Session, secret: str) -> Principal | None:
    """Return who signed in; None when the session or its token has ended.

    The secret has 256 bits and is looked up by its digest, so that no timing tells of it.
    """
    if len(secret) > MAX_SECRET_LENGTH:
        return None
    row = session.execute(
        select(PageSession, Token)
        .join(Token, Token.id == PageSession.token_id)
        .where(PageSession.secret_digest == secret_digest(secret))
    ).first()
    if row is None or row[0].expires_at <= database_now(session):
        return None
    return principal_of(session, row[1])


def end_page_session(session: Session, secret: str) -> None:
    """End a session; ending it twice does nothing."""
    session.execute(delete(PageSession).where(PageSession.secret_digest == secret_digest(secret)))


def new_secret() -> str:
    """Return the secret of a new session: 256 bits."""
    return secrets.token_urlsafe(32)


def secret_digest(secret: str) -> str:
    """Return what is kept of a secret."""
    return hashlib.sha256(secret.encode("utf-8", "surrogatepass")).hexdigest()


# Browsers in which a person signed in: the rights of a member of one team, or of an organizer.


def open_person_session(session: Session, person: Person) -> str:
    """Open a session; its secret is returned here and never again.

    An organizer begins as one; anybody else acts for the first of their teams.
    """
    now = database_now(session)
    session.execute(delete(PersonSession).where(PersonSession.expires_at <= now))
    teams = [] if person.is_organizer else teams_of(session, person.id)
    secret = new_secret()
    session.add(
        PersonSession(
            secret_digest=secret_digest(secret),
            person_id=person.id,
            team_id=teams[0].id if teams else None,
            created_at=now,
            expires_at=now + LIFETIME,
        )
    )
    audit(session, f"person:{person.id}", "signed in", person.id)
    return secret


def find_person_session(session: Session, secret: str) -> Principal | None:
    """Return who signed in, with the rights that they have at this moment."""
    row = session.execute(
        select(PersonSession, Person)
        .join(Person, Person.id == PersonSession.person_id)
        .where(PersonSession.secret_digest == secret_digest(secret))
    ).first()
    if row is None or row[0].expires_at <= database_now(session):
        return None
    found, person = row[0], row[1]
    team = None
    if found.team_id is not None and is_member(session, found.team_id, person.id):
        team = session.get(Team, found.team_id)
    return _principal(person, team)


def act_for(session: Session, secret: str, person_id: str, team_id: int | None) -> None:
    """Let a signed-in person act for another of their teams, or for none.

    Raises:
        NotAllowed: The person does not belong to the team.
    """
    if team_id is not None and not is_member(session, team_id, person_id):
        raise NotAllowed("You do not belong to this team.")
    digest = secret_digest(secret)
    session.execute(
        update(PersonSession).where(PersonSession.secret_digest == digest).values(team_id=team_id)
    )


def end_person_session(session: Session, secret: str) -> None:
    """End a session; ending it twice does nothing."""
    digest = secret_digest(secret)
    session.execute(delete(PersonSession).where(PersonSession.secret_digest == digest))


def _principal(person: Person, team: Team | None) -> Principal:
    """A member acts for the team alone: an organizer's rights are never mixed with a team's."""
    if team is not None:
        scopes = frozenset(str(scope) for scope in TEAM_SCOPES)
    else:
        scopes = frozenset(str(scope) for scope in ORGANIZER_SCOPES if person.is_organizer)
    return Principal(
        token_id="",
        token_name="",
        scopes=scopes,
        expires_at=None,
        team_id=team.id if team else None,
        team_slug=team.slug if team else None,
        team_name=team.name if team else None,
        person_id=person.id,
        person_name=person.name,
    )
