"""Quotas of submissions per team, per UTC day and in total, and a cap on those without a score."""

from datetime import datetime
from functools import cache
from typing import Any

from sqlalchemy import Select, and_, bindparam, func, select
from sqlalchemy.orm import Session

from exceptiondrive_records.db.clock import database_now, next_day, start_of_day
from exceptiondrive_records.db.columns import is_one_of
from exceptiondrive_records.db.errors import (
    ConcurrentQuotaExceeded,
    QuotaExceeded,
    RejectedCapExceeded,
)
from exceptiondrive_records.participation.tables import Allowance
from exceptiondrive_records.phases.policy import own_deadline
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_schemas.api.submission import WAITING, Quota, SubmissionStatus

COSTS_NOTHING = (SubmissionStatus.REJECTED, SubmissionStatus.FAILED)
"""Rejected files and our own failures cost no quota; they count towards the daily cap on files
without a score. A withdrawn submission costs quota, unless its team confirmed another one that
counts in its place."""


def quota_of(session: Session, team_id: int, phase: Phase, day: datetime | None = None) -> Quota:
    """Return what the team has used and may still use today, or on the day of another moment."""
    at = database_now(session) if day is None else day
    midnight, next_midnight = start_of_day(at), next_day(at)
    given = {"team": team_id, "phase": phase.id, "from": midnight, "to": next_midnight}
    found = session.execute(_used_and_granted(), given).one()
    per_day = found.quota_per_day or phase.quota_per_day
    total = found.quota_total or phase.quota_total
    remaining = max(0, per_day - found.used_today)
    if total is not None:
        remaining = min(remaining, max(0, total - found.used_total))
    return Quota(
        per_day=per_day,
        used_today=found.used_today,
        remaining_today=remaining,
        total=total,
        used_total=found.used_total,
        resets_at=next_midnight,
        rejected_per_day=phase.rejected_per_day,
        rejected_today=found.rejected_today,
        concurrent=phase.quota_concurrent,
        waiting=found.waiting,
        closes_at=own_deadline(phase, found.closes_at),
    )


@cache
def _used_and_granted() -> Select[Any]:
    """Build the query for a team's use of its quotas in a phase, and for its allowance there."""
    is_asked_about = Submission.confirmed_as.is_not(None)
    is_counted = ~is_one_of(Submission.status, COSTS_NOTHING) & ~is_asked_about
    is_rejected = is_one_of(Submission.status, COSTS_NOTHING) | is_asked_about
    received_at = Submission.received_at
    is_of_day = (received_at >= bindparam("from")) & (received_at < bindparam("to"))
    used = (
        select(
            func.count().filter(is_counted).label("used_total"),
            func.count().filter(is_counted & is_of_day).label("used_today"),
            func.count().filter(is_rejected & is_of_day).label("rejected_today"),
            func.count().filter(is_one_of(Submission.status, WAITING)).label("waiting"),
        )
        .where(Submission.team_id == bindparam("team"), Submission.phase_id == bindparam("phase"))
        .subquery()
    )
    is_own = and_(Allowance.team_id == bindparam("team"), Allowance.phase_id == bindparam("phase"))
    granted = (Allowance.quota_per_day, Allowance.quota_total, Allowance.closes_at)
    return select(used, *granted).outerjoin_from(used, Allowance, is_own)


def require_quota(quota: Quota, *, is_sound: bool) -> None:
    """Refuse a submission beyond the quota, which `accept` reads under the team's lock.

    `is_sound`: the file is known to be valid, so will not be rejected.

    Raises:
        QuotaExceeded: The day's or the total quota is used up.
        RejectedCapExceeded: Too many files were rejected, or failed, today.
        ConcurrentQuotaExceeded: Too many submissions of the team still wait for their score: more
            than the phase lets wait at once, or more than may turn out to be wrong today.
    """
    if quota.total is not None and quota.left_in_all == 0:
        raise QuotaExceeded(quota.total, resets_at=None)
    if quota.used_today >= quota.per_day:
        raise QuotaExceeded(quota.per_day, resets_at=quota.resets_at)
    if not is_sound:
        if quota.left_of_rejected == 0:
            raise RejectedCapExceeded(quota.rejected_per_day, resets_at=quota.resets_at)
        require_room_if_all_are_wrong(quota)
    if quota.concurrent is not None and quota.left_of_waiting == 0:
        raise ConcurrentQuotaExceeded(quota.concurrent)


def require_room_if_all_are_wrong(quota: Quota) -> None:
    """Let no more submissions wait than may be rejected today: otherwise the cap could be exceeded.

    Raises:
        ConcurrentQuotaExceeded: So many wait already.
    """
    if quota.waiting >= quota.left_of_rejected:
        raise ConcurrentQuotaExceeded(quota.left_of_rejected)
