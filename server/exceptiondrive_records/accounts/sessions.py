"""Browser sessions: the cookie holds a random secret, this table its digest and owner.

A session opened with a token has the token's rights and ends with it. A person's session has the
rights of a member of one team, or of an organizer, looked up at each request.
"""

import secrets
from datetime import timedelta

from sqlalchemy import Select, delete, select, update
from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.people import hold_team, is_member, teams_of
from exceptiondrive_records.accounts.roles import OrganizerRole
from exceptiondrive_records.accounts.tables import BrowserSession, Person, Token
from exceptiondrive_records.accounts.tokens import (
    SCOPES_OF_ROLE,
    TEAM_SCOPES,
    Principal,
    is_live,
    principal_of,
)
from exceptiondrive_records.audit.log import audit, lines_of_a_day
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import Conflict, NotAllowed
from exceptiondrive_records.db.identifiers import secret_digest
from exceptiondrive_records.teams.tables import Team

LIFETIME = timedelta(hours=12)
MAX_SECRET_LENGTH = 100
MAX_SIGN_INS_A_DAY = 200
"""By all tokens of a team together, or by one person: each leaves an audit line forever."""


def open_token_session(session: Session, principal: Principal) -> str:
    """Open a session with the rights of a token; its secret is returned only here.

    Raises:
        Conflict: The team signed in often enough today, or was refused.
    """
    if principal.team_id is not None:
        hold_team(session, principal.team_id)
        own = select(Token.id).where(Token.team_id == principal.team_id)
        _require_sign_ins_left(session, own)
    return _open(session, principal.actor, principal.token_id, token_id=principal.token_id)


def open_person_session(session: Session, person: Person) -> str:
    """Open a session of a person; its secret is returned only here.

    An organizer starts as an organizer; anybody else starts acting for the first of their teams.

    Raises:
        Conflict: The person signed in often enough today.
    """
    _require_sign_ins_left(session, select(Person.id).where(Person.id == person.id))
    teams = [] if person.is_organizer else teams_of(session, person.id)
    team_id = teams[0].id if teams else None
    return _open(session, f"person:{person.id}", person.id, person_id=person.id, team_id=team_id)


def find_session(session: Session, secret: str) -> Principal | None:
    """Return who signed in, with their present rights; None if the session has ended.

    The secret has 256 bits and is looked up by its digest, so that timing reveals nothing about it.
    """
    if not secret or len(secret) > MAX_SECRET_LENGTH:
        return None
    found = session.get(BrowserSession, secret_digest(secret))
    if found is None or found.expires_at <= database_now(session):
        return None
    if found.token_id is not None:
        token = session.get(Token, found.token_id)
        return None if token is None else principal_of(session, token)
    person = session.get_one(Person, found.person_id)
    team = None
    if found.team_id is not None and is_member(session, found.team_id, person.id):
        team = session.get(Team, found.team_id)
    return _principal(person, team)


def require_unrevoked(session: Session, principal: Principal) -> None:
    """Refuse a request whose sender lost the rights that they had when it began.

    Raises:
        NotAllowed: The token was revoked or has expired, or the person was removed from the team or
            has another organizer role now.
    """
    if principal.person_id is None:
        token = session.get(Token, principal.token_id, populate_existing=True)
        is_right = token is not None and is_live(token, database_now(session))
    elif principal.team_id is not None:
        is_right = is_member(session, principal.team_id, principal.person_id)
    else:
        person = session.get_one(Person, principal.person_id, populate_existing=True)
        now = _principal(person, None)
        is_right = (now.scopes, now.phases) == (principal.scopes, principal.phases)
    if not is_right:
        raise NotAllowed(
            "The token, your place in the team or your role ended meanwhile: sign in anew."
        )


def act_for(session: Session, secret: str, person_id: str, team_id: int | None) -> None:
    """Let a signed-in person act for another of their teams, or for none.

    Raises:
        NotAllowed: The person does not belong to the team.
    """
    if team_id is not None and not is_member(session, team_id, person_id):
        raise NotAllowed("You do not belong to this team.")
    session.execute(
        update(BrowserSession)
        .where(BrowserSession.secret_digest == secret_digest(secret))
        .values(team_id=team_id)
    )


def end_session(session: Session, secret: str) -> None:
    """End a session; ending it twice does nothing."""
    digest = secret_digest(secret)
    session.execute(delete(BrowserSession).where(BrowserSession.secret_digest == digest))


def _require_sign_ins_left(session: Session, subjects: Select[str]) -> None:
    if lines_of_a_day(session, ["signed in"], subjects) >= MAX_SIGN_INS_A_DAY:
        raise Conflict(
            f"A team or person may sign in {MAX_SIGN_INS_A_DAY} times in 24 hours. Go on where you are "
            "signed in, by the API or the command line, or sign in later."
        )


def _open(
    session: Session,
    actor: str,
    subject: str,
    *,
    token_id: str | None = None,
    person_id: str | None = None,
    team_id: int | None = None,
) -> str:
    """Add the row, and remove expired sessions."""
    now = database_now(session)
    session.execute(delete(BrowserSession).where(BrowserSession.expires_at <= now))
    secret = secrets.token_urlsafe(32)
    session.add(
        BrowserSession(
            secret_digest=secret_digest(secret),
            token_id=token_id,
            person_id=person_id,
            team_id=team_id,
            created_at=now,
            expires_at=now + LIFETIME,
        )
    )
    audit(session, actor, "signed in", subject)
    return secret


def _principal(person: Person, team: Team | None) -> Principal:
    """Return the principal of a person: a team's rights or an organizer's, never both at once."""
    phases: list[str] = []
    if team is not None:
        scopes = frozenset(str(scope) for scope in TEAM_SCOPES)
    elif person.organizer_role is not None:
        role, phases = OrganizerRole(person.organizer_role), person.organizer_phases
        scopes = frozenset(str(scope) for scope in SCOPES_OF_ROLE[role])
    else:
        scopes = frozenset()
    return Principal(
        token_id="",
        token_name="",
        scopes=scopes,
        expires_at=None,
        team_id=team.id if team else None,
        team_slug=team.slug if team else None,
        team_name=team.name if team else None,
        team_is_pending=team is not None and team.pending_since is not None,
        person_id=person.id,
        person_name=person.name,
        phases=frozenset(phases),
    )
