"""When a phase takes submissions of one team: one may have been granted a later deadline."""

from datetime import datetime

from sqlalchemy.orm import Session

from exceptiondrive_records.participation.tables import Allowance
from exceptiondrive_records.phases.policy import is_open, is_split_revealed
from exceptiondrive_records.phases.tables import Phase


def allowance_of(session: Session, team_id: int, phase_id: str) -> Allowance | None:
    """Return what a team was granted in a phase."""
    return session.get(Allowance, (team_id, phase_id))


def is_open_to(session: Session, phase: Phase, allowance: Allowance | None, now: datetime) -> bool:
    """Whether a phase takes submissions of a team with this allowance.

    A later deadline ends with the reveal of the split: whoever knows the rest would answer it.
    """
    if is_open(phase, now):
        return True
    if phase.visibility != "shown" or (phase.opens_at is not None and now < phase.opens_at):
        return False
    closes_at = None if allowance is None else allowance.closes_at
    return closes_at is not None and now < closes_at and not is_split_revealed(session, phase)
