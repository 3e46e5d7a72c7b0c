"""Submissions of all teams: organizers list, recompute and restore them, and answer in a team's place."""

from typing import Annotated, Any

from fastapi import APIRouter, Path, Query, Request
from fastapi.responses import Response
from pydantic import Field

from exceptiondrive_records.participation.messages import write_about
from exceptiondrive_records.rescoring.changes import verify_submission
from exceptiondrive_records.rescoring.retry import restore_submission, retry_submission
from exceptiondrive_records.rescoring.verification import verification_view
from exceptiondrive_records.submissions.similarity import similarity_report
from exceptiondrive_records.submissions.submissions import find_submission
from exceptiondrive_records.submissions.views import view
from exceptiondrive_schemas.api.notifications import NotificationView
from exceptiondrive_schemas.api.rescoring import VerificationView
from exceptiondrive_schemas.api.similarity import SimilarityReport
from exceptiondrive_schemas.api.submission import SubmissionStatus, SubmissionView
from exceptiondrive_server.submissions.download import any_upload, archive
from exceptiondrive_server.submissions.story import SubmissionStory, story_folder, story_of
from exceptiondrive_server.web.auth import Organizer, ServicesOf
from exceptiondrive_server.web.etag import UNCHANGED
from exceptiondrive_server.web.forms import Action, Form
from exceptiondrive_server.web.path_ids import SubmissionId

router = APIRouter()


class Note(Form):
    """What a team is told about a submission of its own."""

    words: Annotated[str, Field(min_length=1, max_length=4000)]


_TAR: dict[int | str, dict[str, Any]] = {200: {"content": {"application/x-tar": {}}}}


@router.get(
    "/submissions/archive",
    operation_id="downloadSubmissions",
    response_class=Response,
    responses=_TAR,
)
def get_archive(
    services: ServicesOf,
    organizer: Organizer,
    team: Annotated[str | None, Query(max_length=64, description="only of this team")] = None,
    phase: Annotated[str | None, Query(max_length=64, description="only of this phase")] = None,
    status: Annotated[SubmissionStatus | None, Query(description="only with this status")] = None,
) -> Response:
    """Download uploads as a tar, newest first; its last member, `manifest.json`, says what each is."""
    return archive(services, organizer, team=team, phase=phase, status=status)


@router.get("/submissions/{submission_id}", operation_id="showStory")
def get_story(services: ServicesOf, submission_id: SubmissionId) -> SubmissionStory:
    """Get a submission with its whole history."""
    with services.database.read() as session:
        return story_of(session, submission_id)


@router.get(
    "/submissions/{submission_id}/file",
    operation_id="downloadUpload",
    response_class=Response,
    responses={200: {"content": {"application/octet-stream": {}}}, 304: UNCHANGED},
)
def get_file(
    request: Request, services: ServicesOf, organizer: Organizer, submission_id: SubmissionId
) -> Response:
    """Download the bytes that a team sent; the audit log records who did."""
    return any_upload(request, services, organizer, submission_id)


@router.get(
    "/submissions/{submission_id}/folder",
    operation_id="downloadStory",
    response_class=Response,
    responses=_TAR,
)
def get_folder(services: ServicesOf, organizer: Organizer, submission_id: SubmissionId) -> Response:
    """Download a dispute for a committee, as a tar: upload, receipt, story and a README."""
    return story_folder(services, organizer, submission_id)


@router.post(
    "/submissions/{submission_id}/verify", operation_id="verifySubmission", status_code=202
)
def post_verify(
    services: ServicesOf, organizer: Organizer, submission_id: SubmissionId, action: Action
) -> VerificationView:
    """Recompute its score from the upload, and compare every bit; nothing is changed."""
    with services.database.write() as session:
        run = verify_submission(session, submission_id, reason=action.reason, actor=organizer.actor)
        return verification_view(session, run.id)


@router.post("/submissions/{submission_id}/restore", operation_id="restoreSubmission")
def post_restore(
    services: ServicesOf, organizer: Organizer, submission_id: SubmissionId, action: Action
) -> SubmissionView:
    """Restore a withdrawn submission, with its original time."""
    with services.database.write() as session:
        restore_submission(session, submission_id, reason=action.reason, actor=organizer.actor)
    with services.database.read() as session:
        return view(session, find_submission(session, submission_id))


@router.post(
    "/submissions/{submission_id}/note", operation_id="writeAboutSubmission", status_code=201
)
def post_note(
    services: ServicesOf, organizer: Organizer, submission_id: SubmissionId, note: Note
) -> NotificationView:
    """Write to the team of a submission about it: to its inbox and every confirmed address."""
    with services.database.write() as session:
        told = write_about(session, submission_id, words=note.words, actor=organizer.actor)
        return NotificationView.model_validate_json(told.body)


@router.post("/submissions/{submission_id}/retry", operation_id="retrySubmission")
def post_retry(
    services: ServicesOf, organizer: Organizer, submission_id: SubmissionId, action: Action
) -> SubmissionView:
    """Queue a failed submission again, with all its attempts."""
    with services.database.write() as session:
        submission = retry_submission(
            session, submission_id, actor=organizer.actor, reason=action.reason
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
