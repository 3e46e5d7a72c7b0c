"""What a team may still submit: submissions per UTC day and in total; rejected ones are capped."""

from functools import cache

from sqlalchemy import Select, bindparam, func, select
from sqlalchemy.orm import Session

from exceptiondrive_records.db.clock import database_now, next_day, start_of_day
from exceptiondrive_records.db.errors import (
    ConcurrentQuotaExceeded,
    QuotaExceeded,
    RejectedCapExceeded,
)
from exceptiondrive_records.participation.tables import Allowance
from exceptiondrive_records.phases.allowances import allowance_of
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_schemas.api.submission import Quota, SubmissionStatus

COSTS_NOTHING = (SubmissionStatus.REJECTED, SubmissionStatus.FAILED)
"""A wrong file costs no quota, nor does our own failure. A withdrawn submission does, unless another
one counts in its place, as its team confirmed."""
WAITING = (SubmissionStatus.RECEIVED, SubmissionStatus.QUEUED, SubmissionStatus.SCORING)


def quota_of(session: Session, team_id: int, phase: Phase) -> Quota:
    """Return what the team has used and may still use."""
    now = database_now(session)
    given = {"team": team_id, "phase": phase.id, "today": start_of_day(now)}
    used_total, used_today, rejected_today, waiting = session.execute(_counts(), given).one()
    own = allowance_of(session, team_id, phase.id) or Allowance()
    per_day = own.quota_per_day or phase.quota_per_day
    total = own.quota_total or phase.quota_total
    remaining = max(0, per_day - used_today)
    if total is not None:
        remaining = min(remaining, max(0, total - used_total))
    return Quota(
        per_day=per_day,
        used_today=used_today,
        remaining_today=remaining,
        total=total,
        used_total=used_total,
        resets_at=next_day(now),
        rejected_per_day=phase.rejected_per_day,
        rejected_today=rejected_today,
        concurrent=phase.quota_concurrent,
        waiting=waiting,
        closes_at=own.closes_at,
    )


@cache
def _counts() -> Select[int, int, int, int]:
    is_asked_about = Submission.confirmed_as.is_not(None)
    is_counted = Submission.status.not_in(COSTS_NOTHING) & ~is_asked_about
    is_rejected = (Submission.status == SubmissionStatus.REJECTED) | is_asked_about
    is_of_today = Submission.received_at >= bindparam("today")
    return select(
        func.count().filter(is_counted),
        func.count().filter(is_counted & is_of_today),
        func.count().filter(is_rejected & is_of_today),
        func.count().filter(Submission.status.in_(WAITING)),
    ).where(Submission.team_id == bindparam("team"), Submission.phase_id == bindparam("phase"))


def require_quota(session: Session, team_id: int, phase: Phase) -> None:
    """Refuse one submission more than allowed; the caller holds the lock of the team.

    Raises:
        QuotaExceeded: The day's or the total quota is used up.
        RejectedCapExceeded: Too many files were rejected today.
        ConcurrentQuotaExceeded: Too many submissions of the team still wait for their score: more
            than the phase lets wait at once, or more than may turn out to be wrong today.
    """
    quota = quota_of(session, team_id, phase)
    if quota.total is not None and quota.used_total >= quota.total:
        raise QuotaExceeded(quota.total, resets_at=None)
    if quota.used_today >= quota.per_day:
        raise QuotaExceeded(quota.per_day, resets_at=quota.resets_at)
    if quota.rejected_today >= quota.rejected_per_day:
        raise RejectedCapExceeded(quota.rejected_per_day, resets_at=quota.resets_at)
    require_room_if_all_are_wrong(quota)
    if quota.concurrent is not None and quota.waiting >= quota.concurrent:
        raise ConcurrentQuotaExceeded(quota.concurrent)


def require_room_if_all_are_wrong(quota: Quota) -> None:
    """Let no more wait than may turn out to be wrong today, or the cap would not hold.

    Raises:
        ConcurrentQuotaExceeded: So many wait already.
    """
    may_be_wrong = quota.rejected_per_day - quota.rejected_today
    if quota.waiting >= may_be_wrong:
        raise ConcurrentQuotaExceeded(may_be_wrong)
