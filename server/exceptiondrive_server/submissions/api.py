"""Submissions: accept an upload, show its status, withdraw it."""

import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Annotated

from fastapi import APIRouter, Header, Query, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import Response

from exceptiondrive_records.accounts.tokens import Principal
from exceptiondrive_records.db.errors import NotFound
from exceptiondrive_records.entries.selection import choose, publish, unpublish
from exceptiondrive_records.phases.phases import find_phase, shown_phase
from exceptiondrive_records.phases.quotas import quota_of
from exceptiondrive_records.submissions.edits import edit_submission, edits_of
from exceptiondrive_records.submissions.submissions import (
    find_submission,
    submission_page,
    withdraw,
)
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.submissions.views import view, views
from exceptiondrive_schemas.api.phase_settings import RunRule
from exceptiondrive_schemas.api.problems import ProblemCode
from exceptiondrive_schemas.api.submission import SubmissionPage, SubmissionStatus, SubmissionView
from exceptiondrive_schemas.method_facts import SubmissionChange, SubmissionEditView
from exceptiondrive_server.submissions.decisions import confirmed_upload, decide
from exceptiondrive_server.submissions.download import own_upload
from exceptiondrive_server.submissions.profile import asked_for_profile
from exceptiondrive_server.submissions.upload import (
    received_upload,
    take_upload,
    told_to,
    upload_body,
)
from exceptiondrive_server.web.auth import Reader, ServicesOf, Submitter, own_team
from exceptiondrive_server.web.etag import UNCHANGED
from exceptiondrive_server.web.path_ids import SubmissionId
from exceptiondrive_server.web.problems import QUOTA_HEADERS, problem_responses, quota_headers
from exceptiondrive_server.web.services import Services

router = APIRouter(prefix="/submissions", tags=["submissions"])
IdempotencyKey = Annotated[
    str | None,
    Header(
        min_length=1,
        max_length=255,
        pattern="^[!-~]+$",
        description="what you name this upload, such as a UUID: sent again it is the same one",
    ),
]
_LOCATION = {"description": "Where the submission is shown.", "schema": {"type": "string"}}
_TAKEN = {"headers": {"Location": _LOCATION, **QUOTA_HEADERS["headers"]}}
_SIGNED_IN = (ProblemCode.NOT_SIGNED_IN, ProblemCode.NOT_ALLOWED)
_OF_OWN = problem_responses(*_SIGNED_IN, ProblemCode.NOT_FOUND)
_CONFLICTS = (*_SIGNED_IN, ProblemCode.NOT_FOUND, ProblemCode.CONFLICT)
_OF_DECISIONS = problem_responses(*_CONFLICTS)
_OF_REPLACING = problem_responses(*_CONFLICTS, ProblemCode.NOT_CONFIRMED)


@router.post(
    "",
    operation_id="submit",
    status_code=202,
    openapi_extra=upload_body(),
    responses={
        200: {
            "model": SubmissionView,
            "description": "The same bytes were there before.",
            **_TAKEN,
        },
        202: {"description": "The file is kept, and waits to be scored.", **_TAKEN},
        **problem_responses(
            *_SIGNED_IN,
            ProblemCode.PHASE_CLOSED,
            ProblemCode.NOT_FOUND,
            ProblemCode.CONFLICT,
            ProblemCode.UPLOAD_EMPTY,
            ProblemCode.UPLOAD_TOO_LARGE,
            ProblemCode.UNSUPPORTED_MEDIA_TYPE,
            ProblemCode.QUOTA_EXCEEDED,
            ProblemCode.REJECTED_CAP_EXCEEDED,
            ProblemCode.TOO_MANY_REQUESTS,
        ),
    },
)
async def submit(
    request: Request,
    response: Response,
    services: ServicesOf,
    principal: Submitter,
    idempotency_key: IdempotencyKey = None,
) -> SubmissionView:
    """Upload a file. It is stored before the response is sent; workers read and score it later.

    The same bytes again return the first submission (200) and cost no quota, unless it was
    withdrawn; if method, description, link, `facts` or `linked_to` differ from it, they are
    refused (409). With an `Idempotency-Key`, the same upload sent again within 24 hours gets the
    first response (202), even if the submission was withdrawn meanwhile; the key with other
    bytes, or in another phase, is refused (409). A key is 1 to 255 visible ASCII characters.

    Scores and ranks of an existing submission are shown only to a token with `read:own`; this also
    holds when a submission is changed, withdrawn, confirmed, chosen or published.

    The headers `RateLimit-Limit`, `RateLimit-Remaining` and `RateLimit-Reset` (in seconds) say what
    the team may still submit to the phase; responses about a phase, a submission, or the submissions
    of one phase carry them, too.
    """
    began_s = time.monotonic()
    async with received_upload(request, services, principal) as upload:
        taken, quota = await run_in_threadpool(
            take_upload, services, principal, upload, began_s, idempotency_key
        )
    response.status_code = 200 if taken.is_duplicate else 202
    response.headers["Location"] = f"/api/v1/submissions/{taken.id}"
    response.headers.update(quota_headers(quota))
    return taken


@router.get(
    "",
    operation_id="listSubmissions",
    responses={200: QUOTA_HEADERS, **_OF_OWN},
)
def get_submissions(
    response: Response,
    services: ServicesOf,
    principal: Reader,
    phase: Annotated[str | None, Query(max_length=64, description="id: only of this phase")] = None,
    status: Annotated[SubmissionStatus | None, Query(description="only with this status")] = None,
    limit: Annotated[int, Query(ge=1, le=200, description="submissions at a time")] = 50,
    after: Annotated[str | None, Query(max_length=64, description="`next` of a page")] = None,
) -> SubmissionPage:
    """List the team's submissions, newest first; organizers see those of all teams (confined ones need `phase`).

    For one phase, headers say what the team may still submit in it. For an unknown phase, a team gets an
    empty list, an organizer an error.
    """
    with services.database.read() as session:
        if phase is not None and principal.team_id is not None:
            with suppress(NotFound):  # then the list is empty
                quota = quota_of(session, principal.team_id, shown_phase(session, phase))
                response.headers.update(quota_headers(quota))
        team_id = own_team(principal, phase)
        if phase is not None and team_id is None:
            find_phase(session, phase)
        found, following = submission_page(
            session, team_id=team_id, phase_id=phase, status=status, after=after, limit=limit
        )
        return SubmissionPage(submissions=views(session, found), next=following)


@router.get(
    "/{submission_id}",
    operation_id="showSubmission",
    responses={200: QUOTA_HEADERS, **_OF_OWN},
)
def get_submission(
    response: Response,
    services: ServicesOf,
    principal: Reader,
    submission_id: SubmissionId,
    profile: Annotated[
        bool, Query(description="let what a scored file looks like be worked out: `report.profile`")
    ] = False,
) -> SubmissionView:
    """Get the state of a submission; one of another team answers 404.

    The headers say what its team may still submit in the phase. The profile of a scored planning file is
    computed when it is first requested here or on its page; `awaits_profile` is true until it is there.
    """
    with services.database.read() as session:
        found = find_submission(session, submission_id, team_id=own_team(principal))
        quota = quota_of(session, found.team_id, find_phase(session, found.phase_id))
        response.headers.update(quota_headers(quota))
        seen = view(session, found)
    return asked_for_profile(services, seen) if profile else seen


@router.get(
    "/{submission_id}/file",
    operation_id="downloadSubmission",
    response_class=Response,
    responses={
        200: {
            "content": {"application/octet-stream": {}},
            "description": "The bytes that were sent; the ETag is their digest.",
        },
        304: UNCHANGED,
        **_OF_OWN,
    },
)
def get_file(
    request: Request, services: ServicesOf, principal: Reader, submission_id: SubmissionId
) -> Response:
    """Download the team's own upload, bit for bit; one of another team answers 404."""
    return own_upload(request, services, principal, submission_id)


@router.patch("/{submission_id}", operation_id="editSubmission", responses=_OF_REPLACING)
def patch_submission(
    services: ServicesOf,
    principal: Submitter,
    submission_id: SubmissionId,
    change: SubmissionChange,
) -> SubmissionView:
    """Edit the description of a submission: name, description, links, facts of the method.

    Omitted fields stay, as do score, time and quota; null removes a description, link or fact.
    A name belongs to the method: all its runs in the phase take it. Published boards keep the old
    name; facts are joined when they are read. Taking the name of another method of the team merges
    both into one, of which one run counts: that needs `replace`, and a later rename does not split them.
    """
    edit = partial(edit_submission, change=change)
    return _decide(
        services, principal, submission_id, edit, replace=change.replace, by_organizers=True
    )


@router.get("/{submission_id}/edits", operation_id="listEdits", responses=_OF_OWN)
def get_edits(
    services: ServicesOf, principal: Reader, submission_id: SubmissionId
) -> tuple[SubmissionEditView, ...]:
    """List the edits of a submission's description: who, when, before and after; newest first."""
    with services.database.read() as session:
        find_submission(session, submission_id, team_id=own_team(principal))
        return edits_of(session, submission_id)


@router.post(
    "/{submission_id}/withdraw", operation_id="withdrawSubmission", responses=_OF_DECISIONS
)
def withdraw_submission(
    services: ServicesOf, principal: Submitter, submission_id: SubmissionId
) -> SubmissionView:
    """Withdraw a submission from the board; idempotent."""
    return _decide(services, principal, submission_id, withdraw, by_organizers=True)


@router.post(
    "/{submission_id}/confirm",
    operation_id="confirmSubmission",
    responses=problem_responses(
        *_SIGNED_IN,
        ProblemCode.NOT_FOUND,
        ProblemCode.CONFLICT,
        ProblemCode.PHASE_CLOSED,
        ProblemCode.QUOTA_EXCEEDED,
        ProblemCode.REJECTED_CAP_EXCEEDED,
    ),
)
def confirm_submission(
    services: ServicesOf, principal: Submitter, submission_id: SubmissionId
) -> SubmissionView:
    """Confirm an upload that was sent with `asks_first`, as a new submission that counts; idempotent.

    The deadline is judged by the first byte of the upload, if that came within the last 15 minutes.
    If it would now replace another entry than the one asked about, the response is the same
    submission with the new question: confirm it again.
    """
    return confirmed_upload(services, principal, submission_id)


@router.post("/{submission_id}/choose", operation_id="chooseSubmission", responses=_OF_DECISIONS)
def choose_submission(
    services: ServicesOf,
    principal: Submitter,
    submission_id: SubmissionId,
    rule: Annotated[RunRule, Query(description="which run of the method stands")] = "this",
) -> SubmissionView:
    """Choose which run counts on the board; the last choice before the deadline holds.

    In a phase that shows one entry of each team, this submission becomes that entry. In one that lets
    teams choose the run of a method, this run counts, or the method's best or newest one.
    """
    return _decide(services, principal, submission_id, partial(choose, rule=rule))


@router.post("/{submission_id}/publish", operation_id="publishSubmission", responses=_OF_REPLACING)
def publish_submission(
    services: ServicesOf,
    principal: Submitter,
    submission_id: SubmissionId,
    replace: Annotated[bool, Query(description="it may take the place of a public run")] = False,
) -> SubmissionView:
    """Publish an entry on the board, in a phase that keeps entries private until then."""
    return _decide(services, principal, submission_id, publish, replace=replace)


@router.post(
    "/{submission_id}/unpublish", operation_id="unpublishSubmission", responses=_OF_DECISIONS
)
def unpublish_submission(
    services: ServicesOf, principal: Submitter, submission_id: SubmissionId
) -> SubmissionView:
    """Take an entry off the board again; earlier boards keep what they showed."""
    return _decide(services, principal, submission_id, unpublish)


def _decide(
    services: Services,
    principal: Principal,
    submission_id: str,
    what: Callable[..., Submission],
    *,
    replace: bool = True,
    by_organizers: bool = False,
) -> SubmissionView:
    """Let a team decide about a submission of its own, and tell it how that stands."""
    decide(services, principal, submission_id, what, replace=replace, by_organizers=by_organizers)
    with services.database.read() as session:
        return told_to(principal, view(session, find_submission(session, submission_id)))
