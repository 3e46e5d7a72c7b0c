"""Turns: whose live job is scored next. Decided when a worker is free, not before.

Teams take turns. First comes the team with the least under way, then the one that was served
longest ago, then the one whose file waits longest; within a team the oldest file goes first. So a
flood delays nobody's first file by more than the jobs that run already.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime

from sqlalchemy import ColumnElement, and_, case, func, or_, select, tuple_
from sqlalchemy.dialects.postgresql import insert as postgres_insert
from sqlalchemy.dialects.sqlite import insert as sqlite_insert
from sqlalchemy.orm import Session

from exceptiondrive_records.db.base import JobState
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.work.tables import Job, TeamTurn
from exceptiondrive_schemas.jobs import Lane

_LONG_AGO = datetime.min.replace(tzinfo=UTC)


@dataclass(frozen=True)
class TeamQueue:
    """What the order of turns depends on, for one team."""

    team_id: int
    n_running: int
    n_waiting: int
    oldest_at: datetime
    """When the oldest of those that wait was accepted."""
    served_at: datetime | None
    """When a worker last took a job of the team."""


@dataclass(frozen=True)
class NextJob:
    """The job whose turn it is."""

    job_id: str
    is_rung: bool
    """A message for it is under way."""


Turn = tuple[int, datetime, datetime, int]


def turn_of(queue: TeamQueue, place: int) -> Turn:
    """Return the sort key of a team's waiting job; `place` counts from 1, oldest first."""
    served_at = queue.served_at or _LONG_AGO
    return (queue.n_running + place, served_at, queue.oldest_at, queue.team_id)


def team_to_serve(queues: Sequence[TeamQueue]) -> TeamQueue | None:
    """Return the team whose turn it is; None when nothing waits."""
    waiting = [queue for queue in queues if queue.n_waiting > 0]
    return min(waiting, key=lambda queue: turn_of(queue, 1), default=None)


def jobs_before(queues: Sequence[TeamQueue], team: TeamQueue, place: int) -> int:
    """Return how many waiting jobs are taken before a team's job at `place`."""
    mine = turn_of(team, place)
    return sum(_places_before(queue, mine) for queue in queues)


def served(queue: TeamQueue, now: datetime) -> TeamQueue:
    """Return the team's queue after a worker has taken its oldest job."""
    running, waiting = queue.n_running + 1, queue.n_waiting - 1
    return replace(queue, n_running=running, n_waiting=waiting, served_at=now)


def is_claimable(now: datetime) -> ColumnElement[bool]:
    """Whether a job may be claimed at this time: it waits, or its lease has run out."""
    return or_(
        and_(Job.state == JobState.QUEUED, Job.available_at <= now),
        and_(Job.state == JobState.LEASED, Job.lease_until < now),
    )


def live_job_waits(session: Session) -> bool:
    """Whether any live job waits for a worker now."""
    query = select(Job.id).where(
        Job.lane == Lane.LIVE,
        Job.state == JobState.QUEUED,
        Job.available_at <= database_now(session),
    )
    return session.scalars(query.limit(1)).first() is not None


def is_live_work_open(session: Session) -> bool:
    """Whether a live job waits for a worker now, or is being scored under a lease that holds."""
    now = database_now(session)
    waits = and_(Job.state == JobState.QUEUED, Job.available_at <= now)
    runs = and_(Job.state == JobState.LEASED, Job.lease_until >= now)
    query = select(Job.id).where(Job.lane == Lane.LIVE, or_(waits, runs))
    return session.scalars(query.limit(1)).first() is not None


def team_queues(
    session: Session,
    *,
    max_attempts: int | None = None,
    without_splits: Collection[str] = (),
) -> list[TeamQueue]:
    """Return the live queues of all teams that have one, in no order.

    Args:
        session: Any.
        max_attempts: Jobs with as many attempts do not wait any more.
        without_splits: Split revisions whose jobs cannot be scored here now.
    """
    now = database_now(session)
    waits = _waits(now, max_attempts, without_splits)
    runs = and_(Job.state == JobState.LEASED, Job.lease_until >= now)
    query = (
        select(
            Submission.team_id,
            func.sum(case((runs, 1), else_=0)),
            func.sum(case((waits, 1), else_=0)),
            func.coalesce(func.min(case((waits, Job.created_at))), func.min(Job.created_at)),
            TeamTurn.served_at,
        )
        .join(Submission, Submission.id == Job.submission_id)
        .outerjoin(TeamTurn, TeamTurn.team_id == Submission.team_id)
        .where(Job.lane == Lane.LIVE, Job.state.in_((JobState.QUEUED, JobState.LEASED)))
        .group_by(Submission.team_id, TeamTurn.served_at)
    )
    return [
        TeamQueue(team_id, int(n_running), int(n_waiting), oldest_at, served_at)
        for team_id, n_running, n_waiting, oldest_at, served_at in session.execute(query)
    ]


def next_in_turn(
    session: Session, max_attempts: int, without_splits: Collection[str] = ()
) -> NextJob | None:
    """Return the live job whose turn it is; None when none waits."""
    queues = team_queues(session, max_attempts=max_attempts, without_splits=without_splits)
    team = team_to_serve(queues)
    if team is None:
        return None
    query = (
        select(Job.id, Job.rung_at)
        .join(Submission, Submission.id == Job.submission_id)
        .where(
            Job.lane == Lane.LIVE,
            Submission.team_id == team.team_id,
            _waits(database_now(session), max_attempts, without_splits),
        )
        .order_by(Job.created_at, Job.id)
        .limit(1)
    )
    found = session.execute(query).first()
    return None if found is None else NextJob(found.id, found.rung_at is not None)


def live_jobs_ahead(session: Session, job: Job) -> int:
    """Return how many live jobs run, or are taken before this one, which waits."""
    submission = session.get_one(Submission, job.submission_id)
    queues = team_queues(session)
    n_running = sum(queue.n_running for queue in queues)
    mine = next((queue for queue in queues if queue.team_id == submission.team_id), None)
    if mine is None:
        return n_running
    older = (
        select(func.count(Job.id))
        .join(Submission, Submission.id == Job.submission_id)
        .where(
            Job.lane == Lane.LIVE,
            Submission.team_id == submission.team_id,
            is_claimable(database_now(session)),
            tuple_(Job.created_at, Job.id) < tuple_(job.created_at, job.id),
        )
    )
    place = (session.scalar(older) or 0) + 1
    return n_running + jobs_before(queues, mine, place)


def note_served(session: Session, submission_id: str, now: datetime) -> None:
    """Record, in the transaction of a claim, that the team has had its turn."""
    team_id = session.get_one(Submission, submission_id).team_id
    insert = sqlite_insert if session.get_bind().dialect.name == "sqlite" else postgres_insert
    session.execute(
        insert(TeamTurn)
        .values(team_id=team_id, served_at=now)
        .on_conflict_do_update(index_elements=["team_id"], set_={"served_at": now})
    )


def _places_before(queue: TeamQueue, mine: Turn) -> int:
    """How many waiting jobs of a team have an earlier turn than `mine`."""
    in_earlier_rounds = min(max(mine[0] - 1 - queue.n_running, 0), queue.n_waiting)
    same_round = mine[0] - queue.n_running
    if 1 <= same_round <= queue.n_waiting and turn_of(queue, same_round) < mine:
        return in_earlier_rounds + 1
    return in_earlier_rounds


def _waits(
    now: datetime, max_attempts: int | None, without_splits: Collection[str]
) -> ColumnElement[bool]:
    waits = is_claimable(now)
    if max_attempts is not None:
        waits &= Job.attempts < max_attempts
    if without_splits:
        waits &= Job.split_revision.not_in(without_splits)
    return waits
