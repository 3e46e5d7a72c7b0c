"""Live status of a submission as server-sent events; polling the submission shows the same."""

import asyncio
import time
from collections.abc import AsyncIterator
from functools import partial

from fastapi import APIRouter
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import StreamingResponse
from fastapi.sse import format_sse_event
from sqlalchemy.exc import SQLAlchemyError

from exceptiondrive_records.accounts.sessions import require_unrevoked
from exceptiondrive_records.accounts.tokens import Principal
from exceptiondrive_records.db.errors import NotAllowed, NotFound
from exceptiondrive_records.submissions.submissions import find_submission
from exceptiondrive_records.submissions.views import view
from exceptiondrive_schemas.api.problems import ProblemCode
from exceptiondrive_schemas.api.submission import SubmissionView
from exceptiondrive_server.web.auth import Reader, ServicesOf, own_team
from exceptiondrive_server.web.path_ids import SubmissionId
from exceptiondrive_server.web.problems import problem_responses
from exceptiondrive_server.web.services import Services

router = APIRouter(prefix="/submissions", tags=["submissions"])
KEEP_ALIVE_S = 15.0
RETRY_MS = 2000


@router.get(
    "/{submission_id}/events",
    operation_id="followSubmission",
    response_class=StreamingResponse,
    responses={
        200: {
            "content": {"text/event-stream": {"schema": {"type": "string"}}},
            "description": "One event `submission` per change, its data a SubmissionView.",
        },
        **problem_responses(
            ProblemCode.NOT_SIGNED_IN, ProblemCode.NOT_ALLOWED, ProblemCode.NOT_FOUND
        ),
    },
)
async def follow_submission(
    services: ServicesOf, principal: Reader, submission_id: SubmissionId
) -> StreamingResponse:
    """Send the submission now and at each change, until it has ended and awaits no board.

    Whoever connects again gets it as it is then; what was missed is not sent again. A stream ends with
    `scored`, `rejected`, `failed` or `withdrawn`, and `awaits_board` false: do not connect again after
    these. It may end before: then do, after the milliseconds of `retry`. Where nothing changes, a
    comment comes about every 15 seconds.
    """
    first = await run_in_threadpool(_read, services, principal, submission_id)
    events = _events(services, principal, first)
    headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
    return StreamingResponse(events, media_type="text/event-stream", headers=headers)


async def _events(
    services: Services, principal: Principal, now: SubmissionView
) -> AsyncIterator[bytes]:
    """Poll again and again; no thread is held in between, and the stream ends in time."""
    settings = services.settings
    followed = (now.id, own_team(principal))
    ends_at = time.monotonic() + settings.events_longest_s
    sent_at = time.monotonic()
    with services.polls.following(followed, now):
        yield _event(now)
        while time.monotonic() < ends_at and (now.awaits_board or not now.status.is_terminal):
            await asyncio.sleep(settings.events_every_s)
            seen = now
            try:
                now = await services.polls.now(
                    followed, partial(_read, services, principal, now.id)
                )
                if now == seen and time.monotonic() - sent_at < KEEP_ALIVE_S:
                    continue
                await run_in_threadpool(_require_unrevoked, services, principal)
            except (SQLAlchemyError, NotAllowed, NotFound):
                return  # the client connects again, and is told why: 503 as long as it lasts, 401, 404
            sent_at = time.monotonic()
            yield format_sse_event(comment="still here") if now == seen else _event(now)


def _read(services: Services, principal: Principal, submission_id: str) -> SubmissionView:
    with services.database.read() as session:
        found = find_submission(session, submission_id, team_id=own_team(principal))
        return view(session, found)


def _require_unrevoked(services: Services, principal: Principal) -> None:
    with services.database.read() as session:
        require_unrevoked(session, principal)


def _event(submission: SubmissionView) -> bytes:
    return format_sse_event(
        data_str=submission.model_dump_json(), event="submission", retry=RETRY_MS
    )
