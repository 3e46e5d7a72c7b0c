"""Reference pages: every problem of the API, every fault of a file, the API itself."""

from datetime import timedelta
from functools import cache

from fastapi import APIRouter, Request
from fastapi.responses import Response

from exceptiondrive_records.accounts.attempts import WINDOW
from exceptiondrive_records.accounts.sessions import LIFETIME
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import NotFound
from exceptiondrive_records.phases.phases import list_phases
from exceptiondrive_records.phases.policy import is_open
from exceptiondrive_schemas.api.problems import ProblemCode
from exceptiondrive_schemas.faults import MESSAGES, FaultCode, FaultGroup
from exceptiondrive_schemas.publish.broken_files import report_of
from exceptiondrive_server.guide.machines import DAY_S
from exceptiondrive_server.guide.operations import operations
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.browser_session import is_https
from exceptiondrive_server.web.problem_vocabulary import PROBLEMS
from exceptiondrive_server.web.responses import THEME_COOKIE, YEAR_S, origin_of, page

router = APIRouter(include_in_schema=False)


@router.get("/problems")
def show_problems(request: Request) -> Response:
    """List every code."""
    return page(request, "guide/problems.html", "", problems=PROBLEMS, faults=_fault_words())


@router.get("/problems/{code}")
def show_problem(request: Request, code: str) -> Response:
    """Explain a problem of the API or a fault of a file."""
    if code in set(ProblemCode):
        problem = ProblemCode(code)
        faults = _fault_words() if problem is ProblemCode.FILE_INVALID else {}
        kind = PROBLEMS[problem]
        return page(request, "guide/problem.html", "", code=code, problem=kind, faults=faults)
    if code in set(FaultCode):
        happened, remedy = _split_message(MESSAGES[FaultCode(code)])
        return page(
            request,
            "guide/fault.html",
            "",
            code=code,
            happened=happened,
            remedy=remedy,
            reported=_reported_group(FaultCode(code)),
        )
    raise NotFound("problem", code)


@router.get("/api")
def show_api(request: Request, services: ServicesOf) -> Response:
    """Show how the API is used, and all of it from the application's own description."""
    with services.database.read() as session:
        now = database_now(session)
        is_open_now = [phase.id for phase in list_phases(session) if is_open(phase, now)]
    return page(
        request,
        "guide/api.html",
        "api",
        groups=operations(request.app.openapi()),
        server=origin_of(request),
        phase=next(iter(is_open_now), "PHASE"),
        max_upload_bytes=services.settings.max_upload_bytes,
    )


@router.get("/privacy")
def show_privacy(request: Request) -> Response:
    """Say what is kept of people, who reads it, and how it goes."""
    cookies = {
        "of_host": "__Host-" if is_https(request) else "",
        "session_hours": LIFETIME // timedelta(hours=1),
        "theme": THEME_COOKIE,
        "theme_days": YEAR_S // DAY_S,
    }
    window = WINDOW // timedelta(minutes=1)
    return page(request, "guide/privacy.html", "", cookies=cookies, window_minutes=window)


def _fault_words() -> dict[FaultCode, str]:
    """Every fault of a file, with what is wrong."""
    return {code: _split_message(MESSAGES[code])[0] for code in FaultCode}


@cache
def _reported_group(code: FaultCode) -> FaultGroup:
    """What the checker reports of a file that is broken in just this way."""
    return next(group for group in report_of(code).faults if group.code is code)


def _split_message(message: str) -> tuple[str, str]:
    """Part a message into what is wrong and what to do."""
    happened, colon, remedy = message.partition(": ")
    if not colon:
        return message, ""
    return f"{happened}.", remedy[:1].upper() + remedy[1:]
