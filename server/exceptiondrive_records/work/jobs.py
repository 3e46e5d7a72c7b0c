"""The status machine of jobs: every step is one fenced compare-and-set.

A claim raises the fence; whoever comes with an older fence has lost the lease and changes nothing.
"""

from datetime import datetime, timedelta
from typing import Any, cast

from sqlalchemy import CursorResult, select, update
from sqlalchemy.orm import Session

from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.db.base import JobState
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import Conflict, NotFound
from exceptiondrive_records.db.identifiers import checked_reason
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.rescoring.fan_out import score_waiting_under
from exceptiondrive_records.rescoring.keys import key_of_phase
from exceptiondrive_records.submissions.tables import ScoreSheetRow, Submission
from exceptiondrive_records.work.board_requests import want_board
from exceptiondrive_records.work.claims import Claim, Finish
from exceptiondrive_records.work.tables import Job
from exceptiondrive_records.work.turns import is_claimable, note_served
from exceptiondrive_schemas.faults import CheckReport
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_schemas.score_sheet import ScoreSheet
from exceptiondrive_schemas.submission import SubmissionStatus

__all__ = ["Claim", "Finish", "claim", "finish_failed", "finish_rejected", "finish_scored"]

_ACTOR = "worker"
_OPEN = (SubmissionStatus.RECEIVED, SubmissionStatus.QUEUED, SubmissionStatus.SCORING)


def claim(session: Session, job_id: str, lease_s: float, max_attempts: int) -> Claim | None:
    """Lease a job if it is free; None means: not yours, go away quietly.

    Args:
        session: Of a write transaction.
        job_id: From the message that called the worker.
        lease_s: How long nobody else may have it; longer than the hard limit of a scoring run.
        max_attempts: Beyond this the reconciler gives the job up.
    """
    now = database_now(session)
    lease_until = now + timedelta(seconds=lease_s)
    taken = session.scalars(
        update(Job)
        .where(Job.id == job_id, Job.attempts < max_attempts, is_claimable(now))
        .values(
            state=JobState.LEASED,
            attempts=Job.attempts + 1,
            fence=Job.fence + 1,
            leased_at=now,
            lease_until=lease_until,
            rung_at=None,
            rings=0,
        )
        .returning(Job)
        .execution_options(populate_existing=True)
    ).first()
    if taken is None:
        return None
    if taken.is_first:
        _set_status(session, taken.submission_id, SubmissionStatus.SCORING)
    if taken.lane is Lane.LIVE:
        note_served(session, taken.submission_id, now)
    return _describe(session, taken, max_attempts)


def finish_scored(
    session: Session,
    claim: Claim,
    sheet: ScoreSheet,
    *,
    exact_digest: str,
    measurement_key: str,
    scorer_version: str,
) -> Finish:
    """Record a score sheet: job, sheet, status, audit line and board request, or none of them.

    Args:
        session: Of a write transaction.
        claim: The lease.
        sheet: Rounded for publication.
        exact_digest: Of the unrounded sheet, which stays with the worker.
        measurement_key: Key of the measurements in the worker's private store.
        scorer_version: Which code scored.
    """
    if not _end(session, claim, JobState.DONE):
        return Finish.LEASE_LOST
    key = (claim.submission_id, claim.protocol_digest, claim.split_revision)
    held = session.get(ScoreSheetRow, key)
    if held is not None and held.exact_digest != exact_digest:
        detail = {"held": held.exact_digest, "came": exact_digest}
        audit(session, _ACTOR, "scores differ for one key", claim.submission_id, detail)
    if held is None:
        session.add(
            ScoreSheetRow(
                submission_id=claim.submission_id,
                protocol_digest=claim.protocol_digest,
                split_revision=claim.split_revision,
                sheet=sheet,
                exact_digest=exact_digest,
                measurement_key=measurement_key,
                scorer_version=scorer_version,
                created_at=database_now(session),
            )
        )
    if claim.is_first:
        _set_status(session, claim.submission_id, SubmissionStatus.SCORED)
    if claim.is_first or _is_shown(session, claim):  # a draft's board is asked for once, at its end
        want_board(session, claim.phase_id, claim.protocol_digest, claim.split_revision)
    detail = {"protocol": claim.protocol_digest, "exact_digest": exact_digest}
    audit(session, _ACTOR, "submission scored", claim.submission_id, detail)
    return Finish.RECORDED


def finish_rejected(session: Session, claim: Claim, report: CheckReport) -> Finish:
    """Record that the file is wrong, with the report that lists every fault."""
    if not _end(session, claim, JobState.DONE):
        return Finish.LEASE_LOST
    if claim.is_first:
        _set_status(session, claim.submission_id, SubmissionStatus.REJECTED, report=report)
    faults = {group.code.value: group.count for group in report.faults}
    detail = {"protocol": claim.protocol_digest, "faults": faults}
    audit(session, _ACTOR, "submission rejected", claim.submission_id, detail)
    return Finish.RECORDED


def finish_failed(
    session: Session,
    claim: Claim,
    code: str,
    message: str,
    *,
    retry: bool,
    backoff_s: float = 2.0,
) -> Finish:
    """Record that we could not score: try again after a while, or give up.

    Args:
        session: Of a write transaction.
        claim: The lease.
        code: Stable and fit for publication.
        message: One sentence fit for the team: never a traceback, path or geometry.
        retry: Whether another attempt may help.
        backoff_s: Wait before the second attempt; doubles each time.
    """
    may_retry = retry and claim.attempts < claim.max_attempts
    detail = {"code": code, "attempt": claim.attempts}
    if may_retry:
        if not _requeue(session, claim, backoff_s * 2 ** (claim.attempts - 1)):
            return Finish.LEASE_LOST
        if claim.is_first:
            _set_status(session, claim.submission_id, SubmissionStatus.QUEUED)
        audit(session, _ACTOR, "scoring to be retried", claim.submission_id, detail)
        return Finish.RETRY_LATER
    if not _end(session, claim, JobState.DEAD if retry else JobState.FAILED):
        return Finish.LEASE_LOST
    if claim.is_first:
        set_failed(session, claim.submission_id, code, message)
    audit(session, _ACTOR, "scoring failed", claim.submission_id, detail)
    return Finish.RECORDED


def set_failed(session: Session, submission_id: str, code: str, message: str) -> None:
    """Show a submission as failed, unless it has ended otherwise."""
    status = SubmissionStatus.FAILED
    _set_status(session, submission_id, status, failure_code=code, failure_message=message)


def jobs_of(session: Session, submission_id: str) -> list[Job]:
    """Return the jobs of a submission, oldest first."""
    query = select(Job).where(Job.submission_id == submission_id)
    return list(session.scalars(query.order_by(Job.created_at, Job.id)))


def _is_shown(session: Session, claim: Claim) -> bool:
    """Whether the phase shows what was scored under this protocol and split revision."""
    phase = session.get_one(Phase, claim.phase_id)
    shown = (phase.protocol_digest, phase.split_revision)
    return shown == (claim.protocol_digest, claim.split_revision)


def _end(session: Session, claim: Claim, state: JobState) -> bool:
    """Whether the lease was still held; the job then has ended in `state`."""
    values = {"state": state, "finished_at": database_now(session)}
    return _leave_lease(session, claim, values)


def _requeue(session: Session, claim: Claim, wait_s: float) -> bool:
    available_at = database_now(session) + timedelta(seconds=wait_s)
    return _leave_lease(session, claim, {"state": JobState.QUEUED, "available_at": available_at})


def _leave_lease(session: Session, claim: Claim, values: dict[str, Any]) -> bool:
    changed = session.execute(
        update(Job)
        .where(Job.id == claim.job_id, Job.fence == claim.fence, Job.state == JobState.LEASED)
        .values(lease_until=None, **values)
        .execution_options(synchronize_session=False)
    )
    if cast("CursorResult[Any]", changed).rowcount == 1:
        return True
    detail = {"job": claim.job_id, "fence": claim.fence}
    audit(session, _ACTOR, "stale fence rejected", claim.submission_id, detail)
    return False


def _set_status(
    session: Session, submission_id: str, status: SubmissionStatus, **values: Any
) -> None:
    session.execute(
        update(Submission)
        .where(Submission.id == submission_id, Submission.status.in_(_OPEN))
        .values(status=status, status_at=database_now(session), **values)
        .execution_options(synchronize_session=False)
    )


def _describe(session: Session, job: Job, max_attempts: int) -> Claim:
    query = (
        select(Submission, Phase)
        .join(Phase, Phase.id == Submission.phase_id)
        .where(Submission.id == job.submission_id)
    )
    submission, phase = session.execute(query).one()
    assert job.lease_until is not None
    return Claim(
        job_id=job.id,
        fence=job.fence,
        attempts=job.attempts,
        max_attempts=max_attempts,
        lease_until=job.lease_until,
        lane=job.lane,
        is_first=job.is_first,
        submission_id=submission.id,
        phase_id=phase.id,
        challenge=phase.challenge,
        file_digest=submission.file_digest,
        size_bytes=submission.size_bytes,
        protocol_digest=job.protocol_digest,
        split_name=phase.split_name,
        split_revision=job.split_revision,
    )


# An operator's second chance for what failed by our own fault.


def retry_submission(
    session: Session, submission_id: str, *, actor: str, reason: str | None = None
) -> Submission:
    """Queue a failed submission again, with all its attempts.

    If the protocol was changed since, it is scored under the new one besides: else no board that
    the phase shows would ever hold it.

    Args:
        session: Of a write transaction.
        submission_id: The submission.
        actor: Who.
        reason: Why; kept in the audit log if given.

    Raises:
        InvalidRecord: The reason cannot be kept.
        NotFound: No such submission.
        Conflict: It has not failed, or the team has submitted the same bytes again since.
    """
    submission = session.get(Submission, submission_id, with_for_update=True)
    if submission is None:
        raise NotFound("submission", submission_id)
    if submission.status is not SubmissionStatus.FAILED:
        raise Conflict(f"The submission is {submission.status}; only failed ones can be retried.")
    if _same_bytes_since(session, submission):
        raise Conflict("The team has submitted the same file again since; that one counts.")
    now = database_now(session)
    ended = Job.state.in_((JobState.FAILED, JobState.DEAD))
    query = select(Job).where(Job.submission_id == submission_id, ended).with_for_update()
    for job in session.scalars(query):
        _queue_again(job, now)
    submission.status = SubmissionStatus.RECEIVED
    submission.status_at = now
    submission.failure_code = submission.failure_message = None
    phase = session.get_one(Phase, submission.phase_id)
    score_waiting_under(session, phase.id, key_of_phase(phase))
    detail = {} if reason is None else {"reason": checked_reason(reason)}
    audit(session, actor, "scoring retried by hand", submission_id, detail)
    return submission


def _queue_again(job: Job, now: datetime) -> None:
    job.state = JobState.QUEUED
    job.attempts = job.rings = 0
    job.fence += 1
    job.available_at = now
    job.rung_at = job.lease_until = job.finished_at = None


def _same_bytes_since(session: Session, submission: Submission) -> bool:
    over = (SubmissionStatus.WITHDRAWN, SubmissionStatus.FAILED)
    query = select(Submission.id).where(
        Submission.phase_id == submission.phase_id,
        Submission.team_id == submission.team_id,
        Submission.file_digest == submission.file_digest,
        Submission.status.not_in(over),
    )
    return session.scalars(query).first() is not None
