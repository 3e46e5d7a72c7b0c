"""Ringing for jobs: how many workers are called, and when they are called again.

A job is *rung* while a message for it is under way; a claim ends that. Messages may be lost, so a
job rung long ago is due again; at most a window of them is outstanding, so that a dead worker
does not fill the broker (docs/decisions/0003-sql-is-the-queue.md).

A live ring says "come", not "take this one": the worker takes the job whose turn it is when it
comes (`turns`). So the marks of waiting live jobs only count the messages under way.
"""

from dataclasses import dataclass
from datetime import datetime, timedelta

from sqlalchemy import Select, func, select, update
from sqlalchemy.orm import Session

from exceptiondrive_records.db.base import JobState
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.db.settings import RecordsSettings
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.work.doorbell import Doorbell
from exceptiondrive_records.work.heartbeats import live_workers
from exceptiondrive_records.work.tables import Job
from exceptiondrive_records.work.turns import NextJob, is_claimable
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
    """Call a worker for a job that was just accepted; otherwise others do it soon.

    Returns:
        Whether it was rung: not while the window is full or the broker is away.
    """
    with database.read() as session:
        job = session.get(Job, job_id)
        if job is None or job.state is not JobState.QUEUED or job.rung_at is not None:
            return False
        if outstanding(session, job.lane) >= window(session, job.lane, settings):
            return False
        due = DueJob(job.id, job.fence, job.lane)
    return bool(_ring(database, doorbell, [due]))


def ring_due_jobs(
    database: Database,
    doorbell: Doorbell,
    settings: RecordsSettings,
    lane: Lane,
    *,
    least_room: int | None = None,
) -> int:
    """Fill the window of a lane and call again for lost messages; return how many were rung.

    Workers do this after each job, so that no slot waits for the reconciler's next pass; with
    `least_room` only when there is room for so many, which spares them every second time. The
    reconciler always looks: lost messages fill the window too, and only it calls for them then.
    """
    with database.read() as session:
        room = window(session, lane, settings) - outstanding(session, lane)
        if least_room is not None and room < least_room:
            return 0
        due = due_jobs(session, lane, settings)
    return _ring(database, doorbell, due)


def window(session: Session, lane: Lane, settings: RecordsSettings) -> int:
    """Return how many messages may be outstanding in a lane.

    Live ones are few, since boards wait behind them: what the slots take next, and a little more
    for the time that a new ring takes.
    """
    if settings.window is not None:
        return settings.window
    slots = live_workers(session, lane, ttl_s=settings.heartbeat_ttl_s).slots
    return max(4, slots + 2) if lane is Lane.LIVE else max(16, 4 * slots)


def outstanding(session: Session, lane: Lane) -> int:
    """Return how many jobs of a lane are rung and not yet claimed."""
    query = select(func.count()).where(
        Job.lane == lane,
        Job.state.in_((JobState.QUEUED, JobState.LEASED)),
        Job.rung_at.is_not(None),
    )
    return session.scalar(query) or 0


def due_jobs(session: Session, lane: Lane, settings: RecordsSettings) -> list[DueJob]:
    """Return the jobs to ring for now: lost rings, then new ones up to the window."""
    now = database_now(session)
    alive = live_workers(session, lane, ttl_s=settings.heartbeat_ttl_s)
    longest_s = _LONGEST_WAIT_S if alive.workers else _LONGEST_WAIT_WITHOUT_WORKERS_S
    claimable = _claimable(lane, now, settings.max_attempts)
    rung = session.scalars(claimable.where(Job.rung_at.is_not(None)))
    again = [job for job in rung if _is_lost(job, now, settings.ring_again_after_s, longest_s)]
    room = window(session, lane, settings) - outstanding(session, lane)
    fresh: list[Job] = []
    if room > 0:
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


def hand_ring_over(session: Session, taken: NextJob) -> None:
    """Note, in the transaction of a claim, which message is used up.

    The worker came for some job and took another. If that one had no message of its own, one of
    the others now has none: the youngest, which is rung again when there is room.
    """
    if taken.is_rung:
        return
    youngest = (
        select(Job.id)
        .where(Job.lane == Lane.LIVE, Job.state == JobState.QUEUED, Job.rung_at.is_not(None))
        .order_by(Job.created_at.desc(), Job.id.desc())
        .limit(1)
    )
    session.execute(
        update(Job)
        .where(Job.id == youngest.scalar_subquery())
        .values(rung_at=None, rings=0)
        .execution_options(synchronize_session=False)
    )


def _ring(database: Database, doorbell: Doorbell, due: list[DueJob]) -> int:
    rung = [job for job in due if doorbell.ring_score(job.job_id, job.lane)]
    if rung:
        with database.write() as session:
            for job in rung:
                mark_rung(session, job)
    return len(rung)


def _claimable(lane: Lane, now: datetime, max_attempts: int) -> Select[Job]:
    return (
        select(Job)
        .where(Job.lane == lane, Job.attempts < max_attempts, is_claimable(now))
        .order_by(Job.created_at, Job.id)
    )


def _is_lost(job: Job, now: datetime, first_s: float, longest_s: float) -> bool:
    assert job.rung_at is not None
    wait_s = min(first_s * 2 ** min(job.rings - 1, _DOUBLINGS), max(first_s, longest_s))
    return job.rung_at + timedelta(seconds=wait_s) < now
