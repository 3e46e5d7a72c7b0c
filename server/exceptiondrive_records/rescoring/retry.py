"""Retry submissions that failed through our own fault, and restore withdrawn ones."""

from sqlalchemy import select
from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.people import hold_team
from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.boards.standings import stood_at_deadline
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import Conflict
from exceptiondrive_records.db.identifiers import checked_reason
from exceptiondrive_records.notifications.inbox import tell_about
from exceptiondrive_records.phases.policy import has_revealed
from exceptiondrive_records.phases.quotas import quota_of
from exceptiondrive_records.phases.scoring_keys import key_of_phase
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.rescoring.fan_out import score_left_out
from exceptiondrive_records.submissions.submissions import (
    find_submission,
    lock_jobs,
    same_bytes,
    scored_under,
)
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.work.board_requests import want_board
from exceptiondrive_records.work.jobs import jobs_of, new_job, queue_again
from exceptiondrive_records.work.tables import Job, WorkState
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.jobs import Lane


def retry_submission(
    session: Session, submission_id: str, *, actor: str, reason: str | None = None
) -> Submission:
    """Queue a failed submission again, with all its attempts.

    If the protocol was changed since, it is also scored under the new one, as otherwise no shown
    board would list it. A reason is kept in the audit log.

    Raises:
        InvalidRecord: The reason cannot be stored.
        NotFound: No such submission.
        Conflict: It has not failed; the team has submitted the same bytes again since; or the team
            has no quota left for it: a failed submission costs none, a retried one does.
    """
    hold_team(session, find_submission(session, submission_id).team_id)
    lock_jobs(session, Job.submission_id == submission_id)
    submission = find_submission(session, submission_id, lock=True)
    if submission.status is not SubmissionStatus.FAILED:
        raise Conflict(f"The submission is {submission.status}; only failed ones can be retried.")
    _require_only_one(session, submission)
    phase = session.get_one(Phase, submission.phase_id)
    _require_place(session, submission, phase)
    now = database_now(session)
    ended = Job.state.in_((WorkState.FAILED, WorkState.DEAD))
    queue_again(session, Job.submission_id == submission_id, ended)
    submission.status = SubmissionStatus.RECEIVED
    submission.status_at = now
    submission.failure_code = submission.failure_message = None
    score_left_out(session, phase.id, key_of_phase(phase))
    detail = {} if reason is None else {"reason": checked_reason(reason)}
    audit(session, actor, "scoring retried by hand", submission_id, detail)
    told = "It waits for its score at its old place in time, and counts in the quota of its day."
    tell_about(session, submission, f"An organizer queued {submission.method} again", (told,))
    return submission


def restore_submission(
    session: Session, submission_id: str, *, actor: str, reason: str
) -> Submission:
    """Restore a withdrawn submission, with its original time; the quota is unchanged.

    Its sheets were kept: it is scored only if it has none under the key that the phase shows now.

    Raises:
        InvalidRecord: The reason cannot be stored.
        NotFound: No such submission.
        Conflict: It was not withdrawn; another submission counts in its place, as the team
            confirmed; the team has submitted the same bytes again since; or it was withdrawn before
            the deadline, and kept-back scores were revealed since.
    """
    hold_team(session, find_submission(session, submission_id).team_id)
    lock_jobs(session, Job.submission_id == submission_id)
    submission = find_submission(session, submission_id, lock=True)
    if submission.status is not SubmissionStatus.WITHDRAWN:
        raise Conflict(f"The submission is {submission.status}; only withdrawn ones are restored.")
    if submission.confirmed_as is not None:
        raise Conflict(f"It was a question, and confirmed as {submission.confirmed_as}.")
    _require_only_one(session, submission)
    phase = session.get_one(Phase, submission.phase_id)
    held_place = select(Submission.id).where(
        Submission.id == submission_id, stood_at_deadline(phase)
    )
    if session.scalar(held_place) is None and has_revealed(
        session, phase, submission.withdrawn_at or submission.received_at
    ):
        raise Conflict(
            "Hidden scores have been revealed since it was withdrawn, so it can no longer be restored."
        )
    detail = {"reason": checked_reason(reason)}
    now = database_now(session)
    jobs = jobs_of(session, submission_id)
    was_scored = any(job.is_first and job.state is WorkState.DONE for job in jobs)
    submission.status = SubmissionStatus.SCORED if was_scored else SubmissionStatus.RECEIVED
    submission.status_at = now
    submission.withdrawn_at = None
    queue_again(session, Job.submission_id == submission_id, Job.state == WorkState.CANCELLED)
    shown = key_of_phase(phase)
    if not any((job.protocol_digest, job.split_revision) == shown for job in jobs):
        session.add(new_job(submission, *shown, Lane.RESCORE, False, now))
    for key in scored_under(session, submission_id):
        want_board(session, submission.phase_id, *key)
    audit(session, actor, "submission restored", submission_id, detail)
    told = "It is withdrawn no longer, and has its old place in time."
    tell_about(session, submission, f"An organizer restored {submission.method}", (told,))
    return submission


def _require_place(session: Session, submission: Submission, phase: Phase) -> None:
    quota = quota_of(session, submission.team_id, phase, submission.received_at)
    if quota.remaining_today == 0:
        raise Conflict(
            "It has used no quota so far, and the team has none left for that day or for the phase. To "
            "have this one scored as well, give the team an allowance first."
        )


def _require_only_one(session: Session, submission: Submission) -> None:
    digest = submission.file_digest
    if same_bytes(session, submission.team_id, submission.phase_id, digest) is not None:
        raise Conflict("The team has submitted the same file again since; that one counts.")
