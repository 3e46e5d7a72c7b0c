"""Select the job to be scored next by fair share, when a worker becomes free, not before.

The team with the fewest running jobs comes first, then the one served longest ago, then the one whose
file has waited longest; within a team, the file that has waited longest. So a flood from one team
delays another's first file only by the jobs that are already running.
"""

from collections.abc import Iterable
from functools import cache

from sqlalchemy import ColumnElement, Select, and_, exists, func, or_, select
from sqlalchemy.orm import Session, aliased

from exceptiondrive_records.db.clock import NOW
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.work.lease import CLAIMED_FROM, is_claimable
from exceptiondrive_records.work.tables import IS_OPEN_JOB, Job, WorkState
from exceptiondrive_schemas.jobs import Lane

_WAITS_NOW = and_(Job.state == WorkState.QUEUED, Job.available_at <= NOW)
_RUNS = and_(Job.state == WorkState.LEASED, Job.lease_until >= NOW)
LIVE_WORK_OPEN = exists().where(
    Job.lane == Lane.LIVE, Job.state.in_(CLAIMED_FROM), or_(_WAITS_NOW, _RUNS)
)
"""Condition: a live job waits for a worker now, or is being scored under a valid lease."""
_N_LIVE_RUNNING = select(func.count(Job.id)).where(Job.lane == Lane.LIVE, _RUNS)
_IS_LIVE_JOB_WAITING = select(exists().where(Job.lane == Lane.LIVE, _WAITS_NOW))
_IS_LIVE_WORK_OPEN = select(LIVE_WORK_OPEN)


def waits(lane: Lane) -> ColumnElement[bool]:
    """Condition on `Job`: it is in this lane, free and due."""
    return and_(Job.lane == lane, is_claimable(Job, NOW))


def fair_order(
    waiting: ColumnElement[bool], lane: Lane, *, firsts_alone: bool = False
) -> Select[str]:
    """Select the ids of waiting jobs in the order of scoring.

    `waiting` is a condition on `Job` (`waits`). `firsts_alone` selects only each team's oldest job,
    one of which is the next of all; the cost then grows with the number of teams, not of jobs.
    """
    one = aliased(Job) if firsts_alone else Job
    place = func.row_number().over(
        partition_by=one.team_id, order_by=(one.created_at, one.id)
    )  # 1 is the team's oldest
    rows = select(one.id, one.team_id, one.created_at, place.label("place"))
    if firsts_alone:
        waits_of_team = select(Job.id).where(Job.team_id == Team.id, IS_OPEN_JOB, waiting)
        oldest = waits_of_team.order_by(Job.created_at, Job.id).limit(1).correlate(Team)
        queue = rows.select_from(Team).join(one, one.id == oldest.scalar_subquery()).cte()
    else:
        queue = rows.where(waiting).cte()
    # MATERIALIZED: PostgreSQL would expect one row, and evaluate a CTE again for each joined row.
    running = (
        select(Job.team_id, func.count(Job.id).label("number"))
        .where(Job.lane == lane, _RUNS)
        .group_by(Job.team_id)
        .cte()
        .prefix_with("MATERIALIZED", dialect="postgresql")
    )
    taken = aliased(Job)
    of_team = and_(taken.team_id == queue.c.team_id, taken.lane == lane)
    served_at = select(func.max(taken.leased_at)).where(of_team).scalar_subquery()
    share = (  # one row per team, not per job: a flood has thousands
        select(
            queue.c.team_id,
            served_at.label("served_at"),
            func.min(queue.c.created_at).label("oldest_at"),
        )
        .group_by(queue.c.team_id)
        .cte()
        .prefix_with("MATERIALIZED", dialect="postgresql")
    )
    return (
        select(Job.id)
        .select_from(share)  # SQLite joins in this order: a team's jobs, not each job's team
        .join(queue, queue.c.team_id == share.c.team_id)
        .join(Job, Job.id == queue.c.id)
        .outerjoin(running, running.c.team_id == queue.c.team_id)
        .where(waiting)  # again: another transaction may have changed it before the lock
        .order_by(
            func.coalesce(running.c.number, 0) + queue.c.place,
            share.c.served_at.asc().nulls_first(),
            share.c.oldest_at,
            share.c.team_id,
        )
    )


def jobs_ahead(session: Session, jobs: Iterable[Job]) -> dict[str, int]:
    """Return, for each of these waiting jobs by id, how many live jobs run or come first."""
    place = {job_id: n for n, job_id in enumerate(session.scalars(_live_order()))}
    n_running = session.scalar(_N_LIVE_RUNNING) or 0
    return {job.id: n_running + place.get(job.id, len(place)) for job in jobs}


@cache
def _live_order() -> Select[str]:
    return fair_order(waits(Lane.LIVE), Lane.LIVE)


def is_live_job_waiting(session: Session) -> bool:
    """Whether any live job waits for a worker now."""
    return bool(session.scalar(_IS_LIVE_JOB_WAITING))


def is_live_work_open(session: Session) -> bool:
    """Whether a live job waits for a worker now, or is being scored under a valid lease."""
    return bool(session.scalar(_IS_LIVE_WORK_OPEN))
