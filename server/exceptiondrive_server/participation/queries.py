"""Queries about a team besides its submissions: people, addresses, allowances, conduct, terms."""

from datetime import datetime

from pydantic import BaseModel
from sqlalchemy import select
from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.people import members_of
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.notifications.contacts import list_contacts, newest_delivery
from exceptiondrive_records.notifications.tables import Channel, DeliveryState
from exceptiondrive_records.participation.allowances import list_allowances
from exceptiondrive_records.participation.disqualification import list_disqualifications
from exceptiondrive_records.participation.tables import Allowance, Disqualification
from exceptiondrive_records.phases.allowances import is_revealed
from exceptiondrive_records.phases.policy import own_deadline
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.phases.terms import acceptances_of
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.teams.teams import list_teams


class AddressView(BaseModel):
    """Where a team is told besides its inbox, as organizers see it."""

    channel: Channel
    address: str
    is_confirmed: bool
    last_message: DeliveryState | None
    """What became of the newest message to it; None: there was none."""


class MemberView(BaseModel):
    """A person who acts for a team."""

    name: str
    email: str | None
    joined_at: datetime


class AllowanceView(BaseModel):
    """What a team has in a phase instead of what all have; null: as all."""

    phase: str
    closes_at: datetime | None = None
    is_ended_by_reveal: bool = False
    """Whether that deadline is still to come, and holds no more since a reveal."""
    quota_per_day: int | None = None
    quota_total: int | None = None
    reason: str = ""
    granted_at: datetime | None = None
    """Null: nothing is granted."""


class DisqualificationView(BaseModel):
    """A team or one entry that was taken off the boards."""

    id: int
    team: str
    phase: str | None
    """Null: in every phase."""
    submission: str | None
    """Null: everything of the team."""
    reason: str
    public_note: str | None
    disqualified_at: datetime
    reinstated_at: datetime | None


class AcceptedTerms(BaseModel):
    """Which version of the terms of a phase a team accepted, and when."""

    phase: str
    version: str
    accepted_at: datetime


class Participation(BaseModel):
    """What organizers see of a team besides its submissions."""

    name: str
    affiliation: str
    standing: str
    """Why it does not take part as others do; empty: it does."""
    members: list[MemberView]
    addresses: list[AddressView]
    allowances: list[AllowanceView]
    disqualifications: list[DisqualificationView]
    terms: list[AcceptedTerms]


def standings_of_teams(session: Session) -> dict[int, str]:
    """Return of the teams that do not take part as others do, why, by key: `disqualified in test`."""
    said: dict[int, str] = {}
    for row in reversed(list_disqualifications(session)):
        if row.reinstated_at is None and row.submission_id is None:
            where = f" in {row.phase_id}" if row.phase_id is not None else ""
            said[row.team_id] = f"disqualified{where}"
    teams = {team.id: team for team in list_teams(session)}
    for team in teams.values():
        if team.merged_into_id is not None:
            said[team.id] = f"part of {teams[team.merged_into_id].slug}"
        elif team.is_gone:
            said[team.id] = "forgotten"
        elif team.pending_since is not None:
            said[team.id] = "waits for approval"
    return said


def participation_of(session: Session, team: Team) -> Participation:
    """Return people, addresses, allowances, conduct and terms of a team."""
    return Participation(
        name=team.name,
        affiliation=team.affiliation,
        standing=standings_of_teams(session).get(team.id, ""),
        members=[
            MemberView(name=person.name, email=person.email, joined_at=membership.joined_at)
            for person, membership in members_of(session, team.id)
        ],
        addresses=_addresses(session, team),
        allowances=[
            allowance_view(session, session.get_one(Phase, row.phase_id), row)
            for row in list_allowances(session, team.id)
        ],
        disqualifications=[
            disqualification_view(session, row)
            for row in list_disqualifications(session, team_id=team.id)
        ],
        terms=[
            AcceptedTerms(phase=row.phase_id, version=row.version, accepted_at=row.accepted_at)
            for row in acceptances_of(session, team.id)
        ],
    )


def _addresses(session: Session, team: Team) -> list[AddressView]:
    found = []
    for contact in list_contacts(session, team.id):
        newest = newest_delivery(session, contact.id)
        found.append(
            AddressView(
                channel=contact.channel,
                address=contact.address,
                is_confirmed=contact.confirmed_at is not None,
                last_message=None if newest is None else newest.outcome,
            )
        )
    return found


def allowance_view(session: Session, phase: Phase, row: Allowance) -> AllowanceView:
    """Return an allowance as organizers see it; a deadline only if it lies after that of the phase."""
    until = own_deadline(phase, row.closes_at)
    is_to_come = until is not None and until > database_now(session)
    return AllowanceView(
        phase=row.phase_id,
        closes_at=until,
        is_ended_by_reveal=is_to_come and is_revealed(session, phase),
        quota_per_day=row.quota_per_day,
        quota_total=row.quota_total,
        reason=row.reason,
        granted_at=row.granted_at,
    )


def disqualification_view(session: Session, row: Disqualification) -> DisqualificationView:
    """Return a disqualification as organizers see it."""
    return DisqualificationView(
        id=row.id,
        team=session.scalars(select(Team.slug).where(Team.id == row.team_id)).one(),
        phase=row.phase_id,
        submission=row.submission_id,
        reason=row.reason,
        public_note=row.public_note,
        disqualified_at=row.disqualified_at,
        reinstated_at=row.reinstated_at,
    )
