"""Submissions that failed by our own fault, as organizers try them again."""

from typing import Annotated

from fastapi import APIRouter
from pydantic import Field

from exceptiondrive_records.retries import retry_submission
from exceptiondrive_records.views import view
from exceptiondrive_schemas.submission import SubmissionView
from exceptiondrive_server.api.organizer_forms import Form
from exceptiondrive_server.api.submissions import SubmissionId
from exceptiondrive_server.auth import Organizer, ServicesOf

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
