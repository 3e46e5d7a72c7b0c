"""Public status of scoring: counts and times, without any team or phase."""

from collections import defaultdict
from datetime import date, datetime, timedelta

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from exceptiondrive_records.boards.tables import BoardRow
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.operations.overview import SLOW_S, lane_queue
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.submissions.views import recent_scoring_s
from exceptiondrive_records.work.heartbeats import live_workers
from exceptiondrive_records.work.tables import Job, WorkerHeartbeat
from exceptiondrive_schemas.api.site import LastBoard, ScoringDay, ServiceStatus
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_schemas.printable import counted

DAYS_TOLD = 7
_AT_MOST = 20_000
"""Maximum number of jobs read for the statistics by day."""


def scoring_delay(session: Session) -> str:
    """Say why scoring is delayed now; empty while it keeps up.

    It is delayed while workers are expected and none is alive, or a submission waits too long.
    """
    queue = lane_queue(session, Lane.LIVE)
    if live_workers(session, Lane.LIVE) == 0:
        is_expected = session.scalar(select(WorkerHeartbeat.worker_id).limit(1)) is not None
        if queue.waiting or queue.running or is_expected:
            return (
                "Scoring is delayed: no worker is alive. Uploads are taken and kept; they are "
                "scored as soon as one is back."
            )
    if (queue.oldest_s or 0) > SLOW_S:
        minutes = counted(round((queue.oldest_s or 0) / 60), "minute")
        return f"Scoring is delayed: the oldest upload has waited for {minutes}. None is lost."
    return ""


def service_status(session: Session) -> ServiceStatus:
    """Return whether submissions are scored now, and statistics of recent days."""
    delay = scoring_delay(session)
    queue = lane_queue(session, Lane.LIVE)
    return ServiceStatus(
        state="delayed" if delay else "up",
        sentence=delay or "Scoring keeps up: submissions are scored as they come.",
        live_workers=live_workers(session, Lane.LIVE),
        waiting=queue.waiting,
        running=queue.running,
        oldest_wait_s=queue.oldest_s,
        usual_scoring_s=recent_scoring_s(session),
        last_board=_last_board(session),
        days=_days(session, database_now(session)),
    )


def _last_board(session: Session) -> LastBoard | None:
    query = (
        select(Phase.id, BoardRow.number, BoardRow.told_at)
        .join(BoardRow, BoardRow.id == Phase.current_board_id)
        .where(Phase.visibility != "hidden")
        .order_by(BoardRow.told_at.desc())
    )
    found = session.execute(query).first()
    return (
        None if found is None else LastBoard(phase=found[0], board=found[1], published_at=found[2])
    )


def _days(session: Session, now: datetime) -> tuple[ScoringDay, ...]:
    since = now - timedelta(days=DAYS_TOLD)
    done = (
        select(Job.created_at, Job.leased_at)
        .where(Job.finished_at >= since, Job.created_at >= since, Job.lane == Lane.LIVE)
        .order_by(Job.finished_at.desc())
        .limit(_AT_MOST)
    )
    waits: dict[date, float] = {}
    for created_at, leased_at in session.execute(done):
        if leased_at is not None:
            day = created_at.date()
            waits[day] = max(waits.get(day, 0.0), (leased_at - created_at).total_seconds())
    failed: defaultdict[date, int] = defaultdict(int)
    failures = select(Submission.status_at, func.count()).where(
        Submission.status == SubmissionStatus.FAILED, Submission.status_at >= since
    )
    for at, count in session.execute(failures.group_by(Submission.status_at)):
        failed[at.date()] += count
    return tuple(
        ScoringDay(day=day, longest_wait_s=waits.get(day), n_failed=failed[day])
        for day in sorted({*waits, *failed}, reverse=True)
    )
