"""Profiles of scored files (how their trajectories look), computed when the team requests them."""

from collections.abc import Iterable

from sqlalchemy import bindparam, select, update
from sqlalchemy.orm import Session

from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.work.lease import ask_once, finish
from exceptiondrive_records.work.tables import OPEN_STATES, Job, Profile, WorkState
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.faults import CheckReport
from exceptiondrive_schemas.jobs import Lane

_COMING = select(Profile.key).where(
    Profile.key.in_(bindparam("submissions", expanding=True)), Profile.state.in_(OPEN_STATES)
)


def ask_for_profile(session: Session, submission_id: str) -> None:
    """Request the profile of a scored file, once, under the key that first scored it."""
    first = select(Job).where(Job.submission_id == submission_id, Job.is_first)
    job = session.scalars(first).one()
    ask_once(
        session,
        Profile,
        submission_id,
        lane=Lane.LIVE,
        submission_id=submission_id,
        protocol_digest=job.protocol_digest,
        split_revision=job.split_revision,
    )


def was_profile_asked_for(session: Session, submission_id: str) -> bool:
    """Whether the profile of a file was ever requested, whatever its outcome."""
    return session.scalar(select(Profile.id).where(Profile.key == submission_id)) is not None


def finish_profile(
    session: Session, item: Profile, report: CheckReport | None, *, note: str | None = None
) -> bool:
    """Record the profile of a file; return False if the lease was lost.

    Without a report the computation failed, and `note` says why.
    """
    if not finish(session, item, WorkState.DONE if report else WorkState.FAILED, note=note):
        return False
    is_told = (Submission.status == SubmissionStatus.SCORED) & Submission.report.is_(None)
    if report is not None:
        session.execute(
            update(Submission)
            .where(Submission.id == item.submission_id, is_told)
            .values(report=report)
            .execution_options(synchronize_session=False)
        )
    return True


def profiles_coming(session: Session, submission_ids: Iterable[str]) -> set[str]:
    """Return those of these submissions whose profiles are still being computed."""
    return set(session.scalars(_COMING, {"submissions": list(submission_ids)}))
