"""Ringing for jobs: what is due, in which order, and how many messages may be outstanding.

A job is *rung* while a message for it is under way; a claim ends that. Messages may be lost, so a
job rung long ago is due again; at most a window of them is outstanding, so that a dead worker
does not fill the broker (research/reliability.md A4).
"""

from dataclasses import dataclass
from datetime import datetime, timedelta

from sqlalchemy import Select, and_, func, or_, select, update
from sqlalchemy.orm import Session

from exceptiondrive_records.clock import database_now
from exceptiondrive_records.database import Database
from exceptiondrive_records.doorbell import Doorbell
from exceptiondrive_records.heartbeats import live_workers
from exceptiondrive_records.settings import RecordsSettings
from exceptiondrive_records.tables import Job, JobState, Submission
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_schemas.submission import SubmissionStatus

_LONGEST_WAIT_S = 30.0
_LONGEST_WAIT_WITHOUT_WORKERS_S = 300.0
_DOUBLINGS = 10


@dataclass(frozen=True)
class DueJob:
    """A job for which a worker is to be called, as it was when looked at."""

    job_id: str
    fence: int
    lane: Lane


def ring_job(
    database: Database, doorbell: Doorbell, job_id: str, settings: RecordsSettings
) -> bool:
    """Call a worker for a job that was just accepted; otherwise the reconciler does it soon.

    Returns:
        Whether it was rung: not while others wait, the window is full or the broker is away.
    """
    with database.read() as session:
        job = session.get(Job, job_id)
        if job is None or job.state is not JobState.QUEUED or job.rung_at is not None:
            return False
        if _others_wait(session, job):
            return False  # the reconciler gives each team its turn
        if outstanding(session, job.lane) >= window(session, job.lane, settings):
            return False
        due = DueJob(job.id, job.fence, job.lane)
    if not doorbell.ring_score(due.job_id, due.lane):
        return False
    with database.write() as session:
        mark_rung(session, due)
    return True


def window(session: Session, lane: Lane, settings: RecordsSettings) -> int:
    """Return how many messages may be outstanding in a lane."""
    if settings.window is not None:
        return settings.window
    return max(16, 4 * live_workers(session, lane, ttl_s=settings.heartbeat_ttl_s).slots)


def outstanding(session: Session, lane: Lane) -> int:
    """Return how many jobs of a lane are rung and not yet claimed."""
    query = select(func.count()).where(
        Job.lane == lane,
        Job.state.in_((JobState.QUEUED, JobState.LEASED)),
        Job.rung_at.is_not(None),
    )
    return session.scalar(query) or 0


def due_jobs(session: Session, lane: Lane, settings: RecordsSettings) -> list[DueJob]:
    """Return the jobs to ring for now: lost rings, then new ones up to the window.

    Teams take turns, and within a team the oldest job goes first: whoever floods the queue delays
    nobody's first file but its own later ones.
    """
    now = database_now(session)
    alive = live_workers(session, lane, ttl_s=settings.heartbeat_ttl_s)
    longest_s = _LONGEST_WAIT_S if alive.workers else _LONGEST_WAIT_WITHOUT_WORKERS_S
    claimable = _claimable(lane, now, settings.max_attempts)
    rung = session.scalars(claimable.where(Job.rung_at.is_not(None)))
    again = [job for job in rung if _is_lost(job, now, settings.ring_again_after_s, longest_s)]
    room = window(session, lane, settings) - outstanding(session, lane)
    if room <= 0:
        fresh: list[Job] = []
    elif lane is Lane.LIVE:
        fresh = list(session.scalars(_in_turn(claimable).limit(room)))
    else:
        fresh = list(session.scalars(claimable.where(Job.rung_at.is_(None)).limit(room)))
    return [DueJob(job.id, job.fence, job.lane) for job in (*again, *fresh)]


def mark_rung(session: Session, due: DueJob) -> None:
    """Note that a message for the job is under way, unless a worker was quicker."""
    now = database_now(session)
    marked = session.scalars(
        update(Job)
        .where(
            Job.id == due.job_id,
            Job.fence == due.fence,
            Job.state.in_((JobState.QUEUED, JobState.LEASED)),
        )
        .values(rung_at=now, rings=Job.rings + 1)
        .returning(Job.submission_id)
        .execution_options(synchronize_session=False)
    ).first()
    if marked is None:
        return
    session.execute(
        update(Submission)
        .where(Submission.id == marked, Submission.status == SubmissionStatus.RECEIVED)
        .values(status=SubmissionStatus.QUEUED, status_at=now)
        .execution_options(synchronize_session=False)
    )


def _others_wait(session: Session, job: Job) -> bool:
    query = select(Job.id).where(
        Job.lane == job.lane,
        Job.state == JobState.QUEUED,
        Job.rung_at.is_(None),
        Job.created_at < job.created_at,
        Job.available_at <= job.created_at,
    )
    return session.scalars(query.limit(1)).first() is not None


def _claimable(lane: Lane, now: datetime, max_attempts: int) -> Select[Job]:
    is_free = or_(
        and_(Job.state == JobState.QUEUED, Job.available_at <= now),
        and_(Job.state == JobState.LEASED, Job.lease_until < now),
    )
    return (
        select(Job)
        .where(Job.lane == lane, Job.attempts < max_attempts, is_free)
        .order_by(Job.created_at, Job.id)
    )


def _in_turn(claimable: Select[Job]) -> Select[Job]:
    """Order live jobs by turns: every team's next one, then every team's second, and so on.

    What a team has under way counts: its next job stands behind the first of an idle team.
    """
    is_open = Job.state.in_((JobState.QUEUED, JobState.LEASED))
    is_waiting = Job.rung_at.is_(None) & (Job.state == JobState.QUEUED)
    turn = func.row_number().over(
        partition_by=Submission.team_id, order_by=(is_waiting, Job.created_at, Job.id)
    )
    turns = (
        select(Job.id, turn.label("turn"))
        .join(Submission, Submission.id == Job.submission_id)
        .where(Job.lane == Lane.LIVE, is_open)
        .subquery()
    )
    return (
        claimable.join(turns, turns.c.id == Job.id)
        .where(Job.rung_at.is_(None))
        .order_by(None)
        .order_by(turns.c.turn, Job.created_at, Job.id)
    )


def _is_lost(job: Job, now: datetime, first_s: float, longest_s: float) -> bool:
    assert job.rung_at is not None
    wait_s = min(first_s * 2 ** min(job.rings - 1, _DOUBLINGS), max(first_s, longest_s))
    return job.rung_at + timedelta(seconds=wait_s) < now
