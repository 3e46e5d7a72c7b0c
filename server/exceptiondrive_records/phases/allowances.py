"""When a phase accepts a team's submissions, which a granted later deadline may extend."""

from datetime import datetime

from sqlalchemy import bindparam, select, update
from sqlalchemy.orm import Session

from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.participation.tables import Allowance
from exceptiondrive_records.phases.policy import has_closed, has_revealed, is_open, own_deadline
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.teams.tables import Team

_ALLOWANCE = select(Allowance).where(
    Allowance.team_id == bindparam("team"), Allowance.phase_id == bindparam("phase")
)


def allowance_of(session: Session, team_id: int, phase_id: str) -> Allowance | None:
    """Return the allowance of a team in a phase, if any."""
    return session.scalars(_ALLOWANCE, {"team": team_id, "phase": phase_id}).first()


def is_open_to(
    session: Session, phase: Phase, own_closes_at: datetime | None, now: datetime
) -> bool:
    """Whether a phase takes submissions of a team, which may have a later deadline of its own.

    A later deadline ends when kept-back scores are revealed, so that nobody can react to them.
    """
    return is_open(phase, now) or (
        is_open(phase, now, own_closes_at) and not is_revealed(session, phase)
    )


def is_revealed(session: Session, phase: Phase) -> bool:
    """Whether kept-back scores were shown since the phase's deadline."""
    return phase.closes_at is not None and has_revealed(session, phase, phase.closes_at)


def running_deadlines(session: Session, phase: Phase) -> list[tuple[Team, datetime]]:
    """Return teams with a later deadline that still runs, and that a reveal of scores would end."""
    if is_revealed(session, phase):
        return []
    query = (
        select(Team, Allowance.closes_at)
        .join(Team, Team.id == Allowance.team_id)
        .where(
            Allowance.phase_id == phase.id,
            Allowance.closes_at > database_now(session),
            Team.merged_into_id.is_(None),
            Team.forgotten_at.is_(None),
        )
        .order_by(Allowance.closes_at, Team.slug)
    )
    found = ((team, own_deadline(phase, until)) for team, until in session.execute(query))
    return [(team, until) for team, until in found if until is not None]


def ended_by_reveal(session: Session, phase: Phase) -> tuple[str, ...]:
    """Say what a reveal of scores would end permanently; nothing if it has happened."""
    if is_revealed(session, phase):
        return ()
    private = ", and no entry is published or made private" if phase.policy.entries_private else ""
    return (
        f"From the reveal on, for good, the deadline moves no more{private}.",
        *(
            f"{team.name} has a deadline of its own, {until:%Y-%m-%d %H:%M} UTC: it ends with the reveal."
            for team, until in running_deadlines(session, phase)
        ),
    )


def end_own_deadlines(session: Session, phase: Phase, now: datetime) -> None:
    """End later deadlines at a reveal, so that nobody chooses by what is shown."""
    if has_closed(phase, now) and is_revealed(session, phase):
        longer = Submission.granted_until > now
        own = update(Submission).where(Submission.phase_id == phase.id, longer)
        session.execute(own.values(granted_until=now))
