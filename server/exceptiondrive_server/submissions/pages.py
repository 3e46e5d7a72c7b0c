"""The quick start, and for signed-in teams the upload form. It works without script."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime

from fastapi import APIRouter, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.exceptions import RequestValidationError
from fastapi.responses import RedirectResponse, Response

from exceptiondrive_records.accounts.tokens import Scope
from exceptiondrive_records.db.errors import RecordsError
from exceptiondrive_records.phases.phases import list_phases, phase_view
from exceptiondrive_records.protocols.protocols import latest_protocol
from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_schemas.problems import ProblemCode
from exceptiondrive_schemas.submission import PhaseView, Quota
from exceptiondrive_server.accounts.browser_session import (
    Browser,
    MaybeSignedIn,
    SignedIn,
    require_form_token,
    require_same_origin,
    require_scope,
)
from exceptiondrive_server.boards.queries import phase_link
from exceptiondrive_server.submissions.accepting import EmptyUpload, arrival_now, take_upload
from exceptiondrive_server.submissions.submit_page import SubmitPage, submit_page
from exceptiondrive_server.submissions.upload_form import received_upload
from exceptiondrive_server.web.auth import ServicesOf, team_of
from exceptiondrive_server.web.problem_vocabulary import PROBLEMS, ApiProblem
from exceptiondrive_server.web.problems import problem_of_fields, problem_of_records, wants_page
from exceptiondrive_server.web.responses import origin_of, page, private_page
from exceptiondrive_server.web.services import Services

# What the upload form shows: open phases, what is left of each quota, and when it begins anew.


_FIELD_WORDS = {"paper_url": "paper", "code_url": "code"}


@dataclass(frozen=True)
class PhaseOption:
    """A phase in the form."""

    id: str
    title: str
    challenge_title: str
    left_words: str
    is_spent: bool
    is_chosen: bool
    resets_at: datetime
    is_late: bool = False
    """Whether it has closed, and what comes now stands on its late view alone."""


@dataclass(frozen=True)
class Refusal:
    """Why the form was refused: a title, a sentence, and what is wrong with which field."""

    title: str
    detail: str
    fields: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class UploadView:
    """Everything that the form needs."""

    team: str
    phases: tuple[PhaseOption, ...]
    max_upload_bytes: int
    form_token: str
    typed: Mapping[str, str] = field(default_factory=dict)
    """What was typed before it was refused."""
    refusal: Refusal | None = None


def refusal_of(code: ProblemCode, detail: str, fields: Mapping[str, str]) -> Refusal:
    """Set a problem as the form says it: the same words as the API and the client."""
    named = tuple((_FIELD_WORDS.get(key, key), why) for key, why in fields.items())
    return Refusal(PROBLEMS[code].title, detail, named)


def upload_view(
    phases: Sequence[PhaseView], team: str, wanted: str | None, form_token: str
) -> UploadView:
    """Set the form; the phase that the address names is chosen, else the first open one.

    Closed phases that still rank late entries come last.
    """
    with_quota = [phase for phase in phases if phase.quota is not None]
    views = [phase for phase in with_quota if phase.is_open]
    views += [phase for phase in with_quota if _takes_late(phase)]
    known = [phase.id for phase in views]
    chosen = wanted if wanted in known else (known[0] if known else None)
    return UploadView(
        team=team,
        phases=tuple(quota_line(phase, is_chosen=phase.id == chosen) for phase in views),
        max_upload_bytes=min((phase.max_upload_bytes for phase in views), default=0),
        form_token=form_token,
    )


def quota_line(phase: PhaseView, *, is_chosen: bool = False) -> PhaseOption:
    """Return a phase with what its team has left."""
    assert phase.quota is not None
    quota = phase.quota
    return PhaseOption(
        id=phase.id,
        title=phase.title,
        challenge_title=CHALLENGES[phase.challenge].title,
        left_words=left_words(quota),
        is_spent=quota.remaining_today == 0 or quota.rejected_today >= quota.rejected_per_day,
        is_chosen=is_chosen,
        resets_at=quota.resets_at,
        is_late=_takes_late(phase),
    )


def _takes_late(phase: PhaseView) -> bool:
    return phase.now is not None and phase.now.takes_late_entries


def left_words(quota: Quota) -> str:
    """Say what is left: `3 of 5 left today, 12 of 20 in all`."""
    words = f"{quota.remaining_today} of {quota.per_day} left today"
    if quota.total is not None:
        words += f", {max(0, quota.total - quota.used_total)} of {quota.total} in all"
    if quota.rejected_today >= quota.rejected_per_day:
        words += f"; {quota.rejected_today} files rejected, which is the limit of a day"
    return words


router = APIRouter(include_in_schema=False)


@router.get("/submit")
def show_submit(request: Request, services: ServicesOf, browser: MaybeSignedIn) -> Response:
    """Show how to submit; to a team that may, the form too."""
    wanted = request.query_params.get("phase")
    content = _quick_start(request, services, wanted)
    if browser is None:
        return page(request, "submissions/submit.html", "submit", page=content, upload=None)
    upload = _upload_view(services, browser, wanted)
    return private_page(request, "submissions/submit.html", "submit", page=content, upload=upload)


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
    status = PROBLEMS[problem.code].status
    answer = private_page(
        request, "submissions/submit.html", "submit", status=status, page=content, upload=upload
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
