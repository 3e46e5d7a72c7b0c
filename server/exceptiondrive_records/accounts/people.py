"""People who sign in through an OpenID provider, and which of them are organizers."""

import hmac
import secrets
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import timedelta
from typing import Any

from sqlalchemy import ColumnElement, and_, bindparam, func, or_, select, update
from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.roles import OrganizerRole, checked_phases
from exceptiondrive_records.accounts.tables import FORGOTTEN, Invitation, Membership, Person
from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.audit.tables import AuditLine
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.database import upsert
from exceptiondrive_records.db.errors import Conflict, InvalidRecord, NotFound
from exceptiondrive_records.db.identifiers import checked_text, random_id, secret_digest
from exceptiondrive_records.teams.tables import Team

MAX_NAME = 80
MAX_EMAIL = 254
"""A longer address is not stored: truncated, it would be somebody else's."""
MAX_SUBJECT = 255
"""The longest that OpenID Connect allows."""


@dataclass(frozen=True)
class Identity:
    """Who signed in, according to the provider."""

    issuer: str
    subject: str
    name: str | None = None
    email: str | None = None


def welcome_person(session: Session, identity: Identity) -> Person:
    """Return the person of an identity, created at the first sign-in; update name and email.

    Only issuer and subject identify a person: an email address may change hands.

    Raises:
        InvalidRecord: The provider's subject cannot be used.
    """
    if not 0 < len(identity.subject) <= MAX_SUBJECT:
        raise InvalidRecord("The provider named nobody.")
    now = database_now(session)
    new: dict[str, Any] = {
        "id": random_id(),
        "issuer": identity.issuer,
        "subject": identity.subject,
        "name": "",
        "email": None,
        "organizer_role": None,
        "organizer_phases": [],
        "created_at": now,
        "signed_in_at": now,
    }
    keys = ("issuer", "subject")
    session.execute(upsert(session, Person, (), (), takes=("signed_in_at",), keys=keys), new)
    query = select(Person).where(
        Person.issuer == identity.issuer, Person.subject == identity.subject
    )
    person = session.scalars(query.execution_options(populate_existing=True)).one()
    person.name = (
        _safe_text((identity.name or "")[:MAX_NAME], MAX_NAME)
        or person.name
        or f"Person {person.id[:6]}"
    )
    person.email = _safe_text(identity.email, MAX_EMAIL)
    return person


def list_people(session: Session) -> list[Person]:
    """Return all people who signed in through the provider and were not forgotten, by name."""
    known = select(Person).where(Person.issuer != FORGOTTEN)
    return list(session.scalars(known.order_by(Person.name, Person.id)))


def find_person(session: Session, person_id: str, *, lock: bool = False) -> Person:
    """Return a person; with `lock`, nobody gives them a role or a team until the transaction ends.

    Raises:
        NotFound: There is none with this id, or they were forgotten.
    """
    person = session.get(Person, person_id, with_for_update=lock, populate_existing=lock)
    if person is None or person.issuer == FORGOTTEN:
        raise NotFound("person", person_id)
    return person


def set_organizer(
    session: Session,
    person_id: str,
    role: OrganizerRole | None,
    phases: Iterable[str] = (),
    *,
    actor: str,
) -> Person:
    """Make a person an organizer, or revoke that; it takes effect with their next request.

    `role` None revokes; without phases the role is for the whole site. Invitations that the person
    made under the former role end, except those into their own teams; tokens that they issued stay
    valid (`left_behind`).

    Raises:
        NotFound: There is no such person or phase.
        InvalidRecord: There are too many phases.
    """
    person = find_person(session, person_id, lock=True)
    wanted = role, checked_phases(session, phases if role else ())
    if (person.organizer_role, person.organizer_phases) != wanted:
        if person.is_organizer:
            own = select(Membership.team_id).where(Membership.person_id == person_id)
            of_others = Invitation.team_id.not_in(own)
            withdraw_invitations_of(session, f"person:{person_id}", of_others, actor=actor)
        person.organizer_role, person.organizer_phases = wanted
        detail = {} if role is None else {"role": str(role), "phases": wanted[1]}
        audit(session, actor, "organizer granted" if role else "organizer ended", person_id, detail)
    return person


def _safe_text(text: str | None, max_length: int) -> str | None:
    """Return a provider's text if it is safe to show, else None: a bad name refuses no sign-in."""
    if text is None:
        return None
    try:
        return checked_text("name", text, max_length=max_length)
    except InvalidRecord:
        return None


# Membership of teams. People join by an invitation: a link that works once.


INVITATION_LIFETIME = timedelta(days=7)
MAX_MEMBERS = 50
MAX_OPEN_INVITATIONS = 20
MAX_INVITATIONS_A_DAY = 100
"""Each leaves a row and audit lines forever, however soon it is withdrawn."""
REGISTRATION_REFUSED = "registration refused"
"""Audit action: the registration of a team was refused; the subject is a person of that team."""
_NO_INVITATION = secret_digest("no such invitation")
_HELD_TEAM = (
    select(Team)
    .where(Team.id == bindparam("team"))
    .with_for_update(key_share=True)
    .execution_options(populate_existing=True)
)


def hold_team(session: Session, team_id: int) -> Team:
    """Lock a team against being merged, forgotten or refused until the transaction ends; return it.

    Callers are serialized, which makes quotas exact. Other transactions may still write rows that
    refer to the team (`FOR NO KEY UPDATE`), such as notices.

    Raises:
        Conflict: It was refused.
    """
    team = session.scalars(_HELD_TEAM, {"team": team_id}).first()
    if team is None:
        raise Conflict("The team was refused meanwhile: nobody acts for it any more.")
    return team


def members_of(session: Session, team_id: int) -> list[tuple[Person, Membership]]:
    """Return the people of a team, in the order in which they joined."""
    query = (
        select(Person, Membership)
        .join(Membership, Membership.person_id == Person.id)
        .where(Membership.team_id == team_id)
        .order_by(Membership.joined_at, Person.id)
    )
    return [(row[0], row[1]) for row in session.execute(query)]


def teams_of(session: Session, person_id: str) -> list[Team]:
    """Return the teams of a person, by name."""
    query = (
        select(Team)
        .join(Membership, Membership.team_id == Team.id)
        .where(Membership.person_id == person_id)
        .order_by(Team.name)
    )
    return list(session.scalars(query))


def is_member(session: Session, team_id: int, person_id: str) -> bool:
    """Whether a person belongs to a team."""
    return session.get(Membership, (team_id, person_id)) is not None


def add_member(session: Session, team: Team, person_id: str, *, actor: str) -> None:
    """Let a person act for a team; adding a member again does nothing.

    Raises:
        NotFound: The person was forgotten meanwhile.
        Conflict: The team is full.
    """
    if is_member(session, team.id, person_id):
        return
    find_person(session, person_id, lock=True)
    count = session.scalar(select(func.count()).where(Membership.team_id == team.id)) or 0
    if count >= MAX_MEMBERS:
        raise Conflict(f"A team has at most {MAX_MEMBERS} members.")
    now = database_now(session)
    session.add(Membership(team_id=team.id, person_id=person_id, joined_at=now))
    audit(session, actor, "member joined", team.slug, {"person": person_id})


def remove_member(session: Session, team_id: int, person_id: str, *, actor: str) -> None:
    """Remove a person from a team; it takes effect with their next request.

    Invitations that they made end too, so that none leads back in.

    Raises:
        NotFound: No such person belongs to the team.
    """
    query = select(Membership, Team.slug).join(Team, Team.id == Membership.team_id)
    is_theirs = (Membership.team_id == team_id, Membership.person_id == person_id)
    found = session.execute(query.where(*is_theirs)).one_or_none()
    if found is None:
        raise NotFound("member", person_id)
    membership, slug = found
    session.delete(membership)
    audit(session, actor, "member removed", slug, {"person": person_id})
    of_team = Invitation.team_id == team_id
    withdraw_invitations_of(session, f"person:{person_id}", of_team, actor=actor)


def removal_of(session: Session, person_id: str) -> tuple[AuditLine, str] | None:
    """Return how a person last left a team (audit line, team name); None if they joined one since.

    They left, were removed, or the team's registration was refused. Only lines about teams and the
    person are read, through the index on subjects: lines about submissions are many.
    """
    lines = select(AuditLine, Team.name).join(Team, Team.slug == AuditLine.subject)
    found = session.execute(lines.where(AuditLine.action == "member removed"))
    own = [(line, name) for line, name in found if line.detail["person"] == person_id]
    is_theirs = (AuditLine.subject == person_id, AuditLine.action == REGISTRATION_REFUSED)
    own += [
        (line, line.detail["name"]) for line in session.scalars(select(AuditLine).where(*is_theirs))
    ]
    last = max(own, key=lambda each: each[0].id, default=None)
    joined = select(func.max(Membership.joined_at)).where(Membership.person_id == person_id)
    joined_at = session.scalar(joined)
    return last if last is None or joined_at is None or joined_at < last[0].at else None


def open_invitations(session: Session, team_id: int) -> list[Invitation]:
    """Return the valid invitations of a team, newest first."""
    query = (
        select(Invitation)
        .where(Invitation.team_id == team_id, *_usable_conditions(session))
        .order_by(Invitation.created_at.desc(), Invitation.id)
    )
    return list(session.scalars(query))


def invite(
    session: Session, team_id: int, invited_by: str, *, actor: str
) -> tuple[str, Invitation]:
    """Make an invitation; the secret at the end of its link is returned only here.

    Raises:
        Conflict: The team reached its limit of open or of daily invitations; or it was refused,
            forgotten or merged into another one.
    """
    team = hold_team(session, team_id)
    team.require_there()
    if len(open_invitations(session, team_id)) >= MAX_OPEN_INVITATIONS:
        raise Conflict(f"{MAX_OPEN_INVITATIONS} invitations are open; withdraw one first.")
    now = database_now(session)
    made = select(func.count(Invitation.id)).where(Invitation.team_id == team_id)
    today = session.scalar(made.where(Invitation.created_at > now - timedelta(days=1))) or 0
    if today >= MAX_INVITATIONS_A_DAY:
        raise Conflict(f"A team may invite {MAX_INVITATIONS_A_DAY} in 24 hours; go on later.")
    invitation_id, secret = random_id(), secrets.token_urlsafe(32)
    invitation = Invitation(
        id=invitation_id,
        team_id=team_id,
        secret_digest=secret_digest(secret),
        invited_by=invited_by,
        made_by=actor,
        created_at=now,
        expires_at=now + INVITATION_LIFETIME,
    )
    session.add(invitation)
    audit(session, actor, "invitation made", team.slug, {"invitation": invitation_id})
    return f"{invitation_id}.{secret}", invitation


def find_invitation(session: Session, text: str, person_id: str | None) -> tuple[Invitation, Team]:
    """Return the invitation of a link, if it may still be used, and its team.

    A person who joined by it still finds it while they belong to the team.

    Raises:
        NotFound: Unknown, used, withdrawn or too old: the sentence is the same.
    """
    invitation_id, _, secret = text.partition(".")
    theirs = select(Membership.team_id).where(Membership.person_id == person_id)
    is_theirs = and_(Invitation.used_by == person_id, Invitation.team_id.in_(theirs))
    query = select(Invitation, Team).join(Team, Team.id == Invitation.team_id)
    is_open = or_(and_(*_usable_conditions(session)), is_theirs)
    found = session.execute(query.where(Invitation.id == invitation_id, is_open)).one_or_none()
    expected = found[0].secret_digest if found is not None else _NO_INVITATION
    is_right = hmac.compare_digest(secret_digest(secret), expected)
    if found is None or not is_right:
        raise _no_invitation(invitation_id)
    return found[0], found[1]


def accept_invitation(session: Session, text: str, person_id: str, *, actor: str) -> Team:
    """Let a person join the team of a link; a link works once.

    A present member of the team does not use it up.

    Raises:
        NotFound: As `find_invitation` raises it.
        Conflict: The team is full, or was refused.
    """
    invitation, team = find_invitation(session, text, person_id)
    hold_team(session, team.id)
    if is_member(session, team.id, person_id):
        return team
    used = session.scalars(
        update(Invitation)
        .where(Invitation.id == invitation.id, *_usable_conditions(session))
        .values(used_at=database_now(session), used_by=person_id)
        .returning(Invitation.id)
    ).one_or_none()
    if used is None:
        raise _no_invitation(invitation.id)
    add_member(session, team, person_id, actor=actor)
    return team


def _no_invitation(invitation_id: str) -> NotFound:
    known = ": it was used or withdrawn, or its week is over. Ask the team for another"
    return NotFound("open invitation", invitation_id[:16], known)


def withdraw_invitation(session: Session, team_id: int, invitation_id: str, *, actor: str) -> None:
    """Withdraw an open invitation of a team, so that its link no longer works.

    Raises:
        NotFound: The team has no such open invitation.
    """
    query = select(Invitation, Team.slug).join(Team, Team.id == Invitation.team_id)
    is_theirs = (Invitation.id == invitation_id, Invitation.team_id == team_id)
    query = query.where(*is_theirs, *_usable_conditions(session)).with_for_update(of=Invitation)
    found = session.execute(query).one_or_none()
    if found is None:
        raise NotFound("invitation", invitation_id)
    invitation, slug = found
    invitation.withdrawn_at = database_now(session)
    audit(session, actor, "invitation withdrawn", slug, {"invitation": invitation_id})


def withdraw_invitations_of(
    session: Session, made_by: str, *of: ColumnElement[bool], actor: str
) -> None:
    """Withdraw invitations of a maker who may no longer invite: all, or those that `of` selects."""
    query = select(Invitation).where(
        Invitation.made_by == made_by, *of, *_usable_conditions(session)
    )
    for invitation in session.scalars(query.order_by(Invitation.id).with_for_update()):
        withdraw_invitation(session, invitation.team_id, invitation.id, actor=actor)


def _usable_conditions(session: Session) -> tuple[ColumnElement[bool], ...]:
    now = database_now(session)
    return (
        Invitation.used_at.is_(None),
        Invitation.withdrawn_at.is_(None),
        Invitation.expires_at > now,
    )
