"""What tests do with work items: claim a certain one, let time pass, look at what waits."""

from contextvars import ContextVar
from datetime import timedelta

from sqlalchemy import ColumnElement, bindparam, select
from sqlalchemy.orm import Session

from exceptiondrive_records.db.clock import NOW
from exceptiondrive_records.db.errors import Violation
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.work.jobs import claim_job
from exceptiondrive_records.work.lease import claim, is_free
from exceptiondrive_records.work.tables import OPEN_STATES, BoardRequest, Job, Profile, WorkItem

_ASKED_FOR: ContextVar[str] = ContextVar("asked for")
_IS_ASKED_FOR = Job.id == bindparam("asked_for", callable_=_ASKED_FOR.get)


def is_job(job_id: str) -> ColumnElement[bool]:
    """Condition: this very job, until another is asked for; one for all, so that a claim is put together once."""
    _ASKED_FOR.set(job_id)
    return _IS_ASKED_FOR


def claim_this(
    session: Session, job_id: str, lease_s: float = 120, max_attempts: int = 4
) -> Job | None:
    """Claim this very job, if it is free."""
    job = session.get(Job, job_id)
    if job is None or job.lane is None:
        return None
    return claim_job(session, job.lane, lease_s, max_attempts, is_job(job_id))


def claim_board_of(
    session: Session,
    phase_id: str,
    protocol_digest: str,
    split_revision: str | None = None,
) -> BoardRequest | None:
    """Claim the build of this very board, if it is wanted and nobody builds it."""
    phase = session.get_one(Phase, phase_id)
    which = (
        (BoardRequest.phase_id == phase_id)
        & (BoardRequest.protocol_digest == protocol_digest)
        & (BoardRequest.split_revision == (split_revision or phase.split_revision))
    )
    free = select(BoardRequest.id).where(which, is_free(BoardRequest, NOW))
    return claim(session, BoardRequest, free, lease_s=30)


def let_time_pass(session: Session, time: timedelta) -> None:
    """Move the recorded times of all work back."""
    for item in session.scalars(select(WorkItem)):
        item.available_at -= time
        item.lease_until = item.lease_until and item.lease_until - time


def unfinished(session: Session) -> list[Violation]:
    """Return what is still to be done: nothing, some time after the last fault."""
    open_jobs = select(Job).where(Job.state.in_(OPEN_STATES))
    found = [
        Violation("unfinished", job.submission_id, f"its job is {job.state} still")
        for job in session.scalars(open_jobs)
    ]
    found += [
        Violation("unfinished", item.submission_id, "what its file looks like is not told")
        for item in session.scalars(select(Profile).where(Profile.state.in_(OPEN_STATES)))
    ]
    wanted = select(BoardRequest).where(BoardRequest.state.in_(OPEN_STATES))
    found += [
        Violation("unfinished", row.phase_id, "a newer board is wanted than was built")
        for row in session.scalars(wanted)
    ]
    return found
