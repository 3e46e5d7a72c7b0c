"""Live status of a submission as server-sent events; polling the submission gives the same."""

import time
from collections.abc import Iterator

from fastapi import APIRouter
from fastapi.responses import StreamingResponse
from fastapi.sse import format_sse_event

from exceptiondrive_records.submissions import find_submission
from exceptiondrive_records.tokens import Principal
from exceptiondrive_records.views import view
from exceptiondrive_schemas.problems import ProblemCode
from exceptiondrive_schemas.submission import SubmissionView
from exceptiondrive_server.api.submissions import SubmissionId
from exceptiondrive_server.auth import Reader, ServicesOf, team_of
from exceptiondrive_server.problems import problem_responses
from exceptiondrive_server.services import Services

router = APIRouter(prefix="/submissions", tags=["submissions"])
EVERY_S = 0.5
LONGEST_S = 300.0
"""After this the client connects again: no thread is held for ever."""


@router.get(
    "/{submission_id}/events",
    operation_id="followSubmission",
    response_class=StreamingResponse,
    responses={
        200: {"content": {"text/event-stream": {}}, "description": "One event per change."},
        **problem_responses(
            ProblemCode.NOT_SIGNED_IN, ProblemCode.NOT_ALLOWED, ProblemCode.NOT_FOUND
        ),
    },
)
def follow_submission(
    services: ServicesOf, principal: Reader, submission_id: SubmissionId
) -> StreamingResponse:
    """Send the submission now and at each change, until it has ended."""
    first = _look(services, principal, submission_id)
    events = _events(services, principal, first)
    headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
    return StreamingResponse(events, media_type="text/event-stream", headers=headers)


def _events(services: Services, principal: Principal, now: SubmissionView) -> Iterator[bytes]:
    deadline = time.monotonic() + LONGEST_S
    yield _event(now)
    while not now.status.is_terminal and time.monotonic() < deadline:
        time.sleep(EVERY_S)
        seen, now = now, _look(services, principal, now.id)
        if now != seen:
            yield _event(now)


def _look(services: Services, principal: Principal, submission_id: str) -> SubmissionView:
    team_id = None if principal.is_organizer else team_of(principal)
    with services.database.read() as session:
        return view(session, find_submission(session, submission_id, team_id=team_id))


def _event(submission: SubmissionView) -> bytes:
    return format_sse_event(data_str=submission.model_dump_json(), event="submission")
