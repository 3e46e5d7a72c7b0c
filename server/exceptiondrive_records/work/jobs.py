"""Claim scoring jobs in fair order; commit score, status, audit line and board request at once."""

from datetime import datetime, timedelta
from functools import lru_cache
from typing import Any

from sqlalchemy import ColumnElement, Select, and_, bindparam, insert, select, update
from sqlalchemy.orm import Session

from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.db.clock import NOW, database_now
from exceptiondrive_records.db.columns import is_one_of
from exceptiondrive_records.db.last import do_last
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.submissions.tables import ScoreSheetRow, Submission
from exceptiondrive_records.work.board_requests import want_board
from exceptiondrive_records.work.fair_share import fair_order, waits
from exceptiondrive_records.work.lease import (
    claim,
    finish,
    give_up,
    new_item,
    try_later,
    wait_before_next_s,
)
from exceptiondrive_records.work.tables import Job, WorkState
from exceptiondrive_schemas.api.submission import WAITING, SubmissionStatus
from exceptiondrive_schemas.faults import CheckReport
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_schemas.score_sheet import ScoreSheet

_ACTOR = "worker"
_OPEN_SUBMISSION = (
    update(Submission)
    .where(Submission.id == bindparam("submission"), is_one_of(Submission.status, WAITING))
    .values(status_at=NOW)
    .execution_options(synchronize_session=False)
)
_IS_OF_JOB = (
    (ScoreSheetRow.submission_id == Submission.id)
    & (ScoreSheetRow.protocol_digest == bindparam("protocol"))
    & (ScoreSheetRow.split_revision == bindparam("revision"))
)
_PHASE_AND_KEPT_DIGEST = (
    select(Phase, ScoreSheetRow.exact_digest)
    .join(Submission, Submission.phase_id == Phase.id)
    .outerjoin(ScoreSheetRow, _IS_OF_JOB)
    .where(Submission.id == bindparam("submission"))
)
_NEW_SHEET = insert(ScoreSheetRow).values(created_at=NOW)
CONFIRM_WITHIN = timedelta(hours=24)
"""How long a file waits for confirmation by its team."""
EXHAUSTED_CODE = "attempts_exhausted"
EXHAUSTED_MESSAGE = (
    "Scoring did not finish in any of its attempts. The organizers see this; your quota is "
    "not used up by it."
)


def new_job(
    submission: Submission,
    protocol_digest: str,
    split_revision: str,
    lane: Lane,
    is_first: bool,
    now: datetime,
    *,
    is_held: bool = False,
) -> Job:
    """Return a waiting job, not yet added to a session."""
    return new_item(
        Job,
        f"{submission.id}/{protocol_digest}/{split_revision}",
        now,
        lane=lane,
        is_held=is_held,
        submission_id=submission.id,
        team_id=submission.team_id,
        protocol_digest=protocol_digest,
        split_revision=split_revision,
        is_first=is_first,
    )


def claim_job(
    session: Session, lane: Lane, lease_s: float, max_attempts: int, *which: ColumnElement[bool]
) -> Job | None:
    """Claim the next job of a lane in fair order; None if none is free.

    The lease is longer than the hard time limit of scoring. After `max_attempts` the reconciler
    gives up a job. `which` are conditions on `Job`, for a worker that cannot score all of them.
    """
    job = claim(session, Job, _in_fair_order(lane, max_attempts, True, *which), lease_s)
    if job is None:  # others may have locked each team's first job: try later ones
        job = claim(session, Job, _in_fair_order(lane, max_attempts, False, *which), lease_s)
    if job is not None and job.is_first:
        _set_status(session, job.submission_id, SubmissionStatus.SCORING)
    return job


@lru_cache
def _in_fair_order(
    lane: Lane, max_attempts: int, firsts_alone: bool, *which: ColumnElement[bool]
) -> Select[str]:
    waiting = and_(waits(lane), Job.attempts < max_attempts, *which)
    return fair_order(waiting, lane, firsts_alone=firsts_alone)


def finish_scored(
    session: Session,
    job: Job,
    sheet: ScoreSheet,
    *,
    exact_digest: str,
    measurement_key: str,
    scorer_version: str,
) -> bool:
    """Record a score sheet: job, sheet, status, audit line and board request, or none of them.

    The sheet is rounded for publication. The unrounded one, of which only the digest is recorded,
    and the measurements of `measurement_key` stay in the worker's private store. Like every
    `finish_...`, it returns whether the lease was still held; otherwise nothing was recorded.
    """
    if not finish(session, job):
        return False
    key = (job.protocol_digest, job.split_revision)
    given = {"submission": job.submission_id, "protocol": key[0], "revision": key[1]}
    phase, kept_digest = session.execute(_PHASE_AND_KEPT_DIGEST, given).one()
    if kept_digest is None:
        made = {
            "submission_id": job.submission_id,
            "protocol_digest": job.protocol_digest,
            "split_revision": job.split_revision,
            "sheet": sheet,
            "exact_digest": exact_digest,
            "measurement_key": measurement_key,
            "scorer_version": scorer_version,
        }
        do_last(session, _NEW_SHEET, made)
    elif kept_digest != exact_digest:
        detail = {"held": kept_digest, "came": exact_digest}
        audit(session, _ACTOR, "scores differ for one key", job.submission_id, detail)
    if job.is_first:
        _set_status(session, job.submission_id, SubmissionStatus.SCORED)
    is_shown = key == (phase.protocol_digest, phase.split_revision)
    if job.is_first or is_shown:  # a draft board is requested once, when all is scored
        want_board(session, phase.id, job.protocol_digest, job.split_revision)
    detail = {"protocol": job.protocol_digest, "exact_digest": exact_digest}
    audit(session, _ACTOR, "submission scored", job.submission_id, detail)
    return True


def finish_rejected(session: Session, job: Job, report: CheckReport) -> bool:
    """Record that a file was rejected, with the report of all its faults."""
    if not finish(session, job):
        return False
    if job.is_first:
        until = database_now(session) + CONFIRM_WITHIN if report.to_confirm else None
        values = {"report": report, "confirm_until": until}
        _set_status(session, job.submission_id, SubmissionStatus.REJECTED, **values)
    faults = {group.code.value: group.count for group in report.faults}
    detail = {"protocol": job.protocol_digest, "faults": faults}
    audit(session, _ACTOR, "submission rejected", job.submission_id, detail)
    return True


def finish_failed(
    session: Session,
    job: Job,
    code: str,
    message: str,
    *,
    retry: bool,
    counts: bool = True,
    max_attempts: int = 4,
    backoff_s: float = 2.0,
) -> bool:
    """Record that scoring failed on our side: retry with exponential backoff, or give up.

    The team sees code and message, which is one sentence: no traceback, path or geometry. `counts`
    is False if this was no attempt, as something that scoring needs is unavailable: jobs then
    wait. The pause before the second attempt is `backoff_s`, and doubles each time.
    """
    detail = {"code": code, "attempt": job.attempts}
    if retry and not (counts and job.attempts >= max_attempts):
        wait_s = wait_before_next_s(job, backoff_s)
        if not try_later(session, job, wait_s, counts=counts, note=code):
            return False
        if job.is_first:
            _set_status(session, job.submission_id, SubmissionStatus.QUEUED)
        if counts:
            audit(session, _ACTOR, "scoring to be retried", job.submission_id, detail)
        return True
    if not finish(session, job, WorkState.DEAD if retry else WorkState.FAILED, note=code):
        return False
    if job.is_first:
        _set_failed(session, job.submission_id, code, message)
    audit(session, _ACTOR, "scoring failed", job.submission_id, detail)
    return True


def give_up_exhausted(session: Session, max_attempts: int) -> int:
    """Give up jobs whose last attempt's lease expired without an answer; return how many."""
    dead = give_up(session, Job, max_attempts)
    for job in dead:
        if job.is_first:
            _set_failed(session, job.submission_id, EXHAUSTED_CODE, EXHAUSTED_MESSAGE)
        detail = {"code": EXHAUSTED_CODE, "job": job.id, "attempts": job.attempts}
        audit(session, "reconciler", "scoring failed", job.submission_id, detail)
    return len(dead)


def queue_again(session: Session, *which: ColumnElement[bool]) -> None:
    """Queue ended jobs again, with all attempts restored and a new time of waiting."""
    now = database_now(session)
    query = select(Job).where(*which).order_by(Job.id).with_for_update()
    for job in session.scalars(query, execution_options={"populate_existing": True}):
        job.state = WorkState.QUEUED
        job.attempts = 0
        job.fence += 1
        job.created_at = job.available_at = now
        job.lease_until = job.finished_at = job.note = None


def jobs_of(session: Session, submission_id: str) -> list[Job]:
    """Return the jobs of a submission, oldest first."""
    query = select(Job).where(Job.submission_id == submission_id)
    return list(session.scalars(query.order_by(Job.created_at, Job.id)))


def _set_failed(session: Session, submission_id: str, code: str, message: str) -> None:
    status = SubmissionStatus.FAILED
    _set_status(session, submission_id, status, failure_code=code, failure_message=message)


def _set_status(
    session: Session, submission_id: str, status: SubmissionStatus, **values: Any
) -> None:
    """Set a submission's status at the end of this transaction, unless it is final already."""
    given = {"submission": submission_id, "status": status}
    do_last(session, _OPEN_SUBMISSION, given | values)
