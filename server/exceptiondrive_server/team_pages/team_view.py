"""What the page of a team's people shows."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

from exceptiondrive_records.tables import Team
from exceptiondrive_records.tables_people import Invitation, Membership, Person
from exceptiondrive_records.tokens import Principal


@dataclass(frozen=True)
class MemberLine:
    """One member."""

    id: str
    name: str
    email: str | None
    joined_at: datetime
    is_you: bool


@dataclass(frozen=True)
class InvitationLine:
    """One invitation that may still be used."""

    id: str
    invited_by: str
    created_at: datetime
    expires_at: datetime


@dataclass(frozen=True)
class Role:
    """For whom a person may act: a team, or the organizers."""

    team_id: int | None
    title: str
    is_current: bool


@dataclass(frozen=True)
class TeamPage:
    """Everything that `team.html` needs."""

    team: str | None
    is_pending: bool
    members: tuple[MemberLine, ...]
    invitations: tuple[InvitationLine, ...]
    roles: tuple[Role, ...]
    link: str | None
    """Of the invitation that was made just now."""
    person: str | None
    may_register: bool
    provider: str | None
    form_token: str


def team_view(
    who: Principal,
    team: Team | None,
    members: Sequence[tuple[Person, Membership]],
    invitations: Sequence[Invitation],
    teams: Sequence[Team],
    *,
    is_organizer: bool,
    may_register: bool,
    provider: str | None,
    link: str | None,
    form_token: str,
) -> TeamPage:
    """Set the page."""
    return TeamPage(
        team=None if team is None else team.name,
        is_pending=team is not None and team.pending_since is not None,
        members=tuple(_member(person, joined, who) for person, joined in members),
        invitations=tuple(
            InvitationLine(one.id, one.invited_by, one.created_at, one.expires_at)
            for one in invitations
        ),
        roles=_roles(who, teams, is_organizer),
        link=link,
        person=who.person_name if who.person_id is not None else None,
        may_register=may_register,
        provider=provider,
        form_token=form_token,
    )


def _member(person: Person, joined: Membership, who: Principal) -> MemberLine:
    is_you = person.id == who.person_id
    return MemberLine(person.id, person.name, person.email, joined.joined_at, is_you)


def _roles(who: Principal, teams: Sequence[Team], is_organizer: bool) -> tuple[Role, ...]:
    """Return the choices, if there is more than one."""
    roles = [Role(team.id, team.name, team.id == who.team_id) for team in teams]
    if is_organizer:
        roles.insert(0, Role(None, "Organizer", who.team_id is None))
    return tuple(roles) if len(roles) > 1 or (roles and not roles[0].is_current) else ()
