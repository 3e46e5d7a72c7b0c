"""Submissions that failed by our own fault, as organizers try them again."""

from typing import Annotated

from fastapi import APIRouter, Path
from pydantic import Field

from exceptiondrive_records.rescoring.retry import retry_submission
from exceptiondrive_records.submissions.similarity import similarity_report
from exceptiondrive_records.submissions.views import view
from exceptiondrive_schemas.similarity import SimilarityReport
from exceptiondrive_schemas.submission import SubmissionView
from exceptiondrive_server.submissions.api import SubmissionId
from exceptiondrive_server.web.auth import Organizer, ServicesOf
from exceptiondrive_server.web.forms import Form

router = APIRouter()


class Retry(Form):
    """Why a failed submission is tried again."""

    reason: Annotated[str, Field(min_length=1, max_length=1000)]


@router.post("/submissions/{submission_id}/retry", operation_id="retrySubmission")
def post_retry(
    services: ServicesOf, organizer: Organizer, submission_id: SubmissionId, retry: Retry
) -> SubmissionView:
    """Queue a failed submission again, with all its attempts."""
    with services.database.write() as session:
        submission = retry_submission(
            session, submission_id, actor=organizer.actor, reason=retry.reason
        )
        session.flush()
        return view(session, submission)


# Which submissions are alike, for organizers alone.


@router.get("/phases/{phase_id}/similar", operation_id="showSimilar")
def get_similar(
    services: ServicesOf, phase_id: Annotated[str, Path(max_length=64)]
) -> SimilarityReport:
    """Show teams with equal or near-equal submissions, and teams that change few samples at a time.

    Reasons to ask a team, not proof: planners that both stand still are alike, too.
    """
    with services.database.read() as session:
        return similarity_report(session, phase_id)
