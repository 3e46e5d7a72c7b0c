"""The quick start, and for signed-in teams the upload form. It works without script."""

from dataclasses import replace

from fastapi import APIRouter, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.exceptions import RequestValidationError
from fastapi.responses import RedirectResponse, Response

from exceptiondrive_records.errors import RecordsError
from exceptiondrive_records.phases import list_phases, phase_view
from exceptiondrive_records.tokens import Scope
from exceptiondrive_server.auth import ServicesOf, team_of
from exceptiondrive_server.browser_session import (
    Browser,
    MaybeSignedIn,
    SignedIn,
    require_form_token,
    require_same_origin,
    require_scope,
)
from exceptiondrive_server.pages.readings import latest_protocol, phase_link
from exceptiondrive_server.pages.responses import page, private_page
from exceptiondrive_server.pages.site import origin_of
from exceptiondrive_server.pages.submit_page import SubmitPage, submit_page
from exceptiondrive_server.problem_vocabulary import STATUS_OF, ApiProblem
from exceptiondrive_server.problems import (
    problem_of_fields,
    problem_of_records,
    wants_page,
)
from exceptiondrive_server.services import Services
from exceptiondrive_server.submitting import EmptyUpload, arrival_now, take_upload
from exceptiondrive_server.team_pages.upload_view import UploadView, refusal_of, upload_view
from exceptiondrive_server.upload_form import received_upload

router = APIRouter(include_in_schema=False)


@router.get("/submit")
def show_submit(request: Request, services: ServicesOf, browser: MaybeSignedIn) -> Response:
    """Show how to submit; to a team that may, the form too."""
    wanted = request.query_params.get("phase")
    content = _quick_start(request, services, wanted)
    if browser is None:
        return page(request, "submit.html", "submit", page=content, upload=None)
    upload = _upload_view(services, browser, wanted)
    return private_page(request, "submit.html", "submit", page=content, upload=upload)


@router.post("/submit")
async def submit(request: Request, services: ServicesOf, browser: Browser) -> Response:
    """Take an upload as the API does, and lead to the page of the submission."""
    require_same_origin(request)
    require_scope(browser, Scope.SUBMIT)
    team_id = team_of(browser.principal)
    arrived_at = await run_in_threadpool(arrival_now, services)
    try:
        async with received_upload(request, has_form_token=True) as upload:
            require_form_token(browser.secret, upload.form_token)
            taken, _ = await run_in_threadpool(take_upload, services, team_id, upload, arrived_at)
    except (RecordsError, RequestValidationError, EmptyUpload) as error:
        if not wants_page(request):
            raise
        return await _refused_form(request, services, browser, _problem_of(error))
    address = f"/submissions/{taken.id}" + ("?again=1" if taken.is_duplicate else "")
    return RedirectResponse(address, status_code=303, headers={"Cache-Control": "no-store"})


async def _refused_form(
    request: Request, services: Services, browser: SignedIn, problem: ApiProblem
) -> Response:
    """Show the form again with what was typed; a browser lets nobody fill in its file."""
    typed = {key: value for key, value in (await request.form()).items() if isinstance(value, str)}
    refusal = refusal_of(problem.code, problem.detail, problem.fields)
    wanted = typed.get("phase")
    content = await run_in_threadpool(_quick_start, request, services, wanted)
    upload = await run_in_threadpool(_upload_view, services, browser, wanted)
    if upload is not None:
        upload = replace(upload, typed=typed, refusal=refusal)
    status = STATUS_OF[problem.code]
    answer = private_page(
        request, "submit.html", "submit", status=status, page=content, upload=upload
    )
    if problem.retry_after_s is not None:
        answer.headers["Retry-After"] = str(problem.retry_after_s)
    return answer


def _problem_of(error: RecordsError | RequestValidationError | ApiProblem) -> ApiProblem:
    if isinstance(error, RecordsError):
        return problem_of_records(error)
    return error if isinstance(error, ApiProblem) else problem_of_fields(error)


def _quick_start(request: Request, services: Services, wanted: str | None) -> SubmitPage:
    with services.database.read() as session:
        phases = tuple(phase_link(session, phase) for phase in list_phases(session))
        protocol = latest_protocol(session)
    return submit_page(phases, protocol, origin_of(request), wanted)


def _upload_view(services: Services, browser: SignedIn, wanted: str | None) -> UploadView | None:
    principal = browser.principal
    if principal.team_id is None or Scope.SUBMIT not in principal.scopes:
        return None
    limit = services.settings.max_upload_bytes
    with services.database.read() as session:
        phases = [
            phase_view(session, phase, max_upload_bytes=limit, team_id=principal.team_id)
            for phase in list_phases(session)
        ]
    return upload_view(phases, principal.team_name or "", wanted, browser.form_token)
