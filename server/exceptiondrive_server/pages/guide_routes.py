"""Routes of the pages that explain: protocols, help, API."""

from fastapi import APIRouter, Request
from fastapi.responses import RedirectResponse, Response

from exceptiondrive_records.drawings import protocol_drawing
from exceptiondrive_records.errors import RecordsError
from exceptiondrive_records.protocols import find_protocol, list_protocols
from exceptiondrive_schemas.problems import ProblemCode
from exceptiondrive_server.pages.api_page import operation_groups
from exceptiondrive_server.pages.help_pages import find_fault, find_problem, help_index
from exceptiondrive_server.pages.problem_help import PROBLEM_HELP
from exceptiondrive_server.pages.protocol_page import protocol_page
from exceptiondrive_server.pages.readings import latest_protocol
from exceptiondrive_server.pages.responses import page, problem_page, refused
from exceptiondrive_server.pages.site import origin_of

router = APIRouter(include_in_schema=False)


@router.get("/protocols")
def show_latest_protocol(request: Request) -> Response:
    """Lead to the newest protocol."""
    with request.app.state.services.database.read() as session:
        version = latest_protocol(session).version
    return RedirectResponse(f"/protocols/{version}", status_code=307)


@router.get("/protocols/{version}")
def show_protocol(request: Request, version: str) -> Response:
    """Show the rules of a protocol."""
    try:
        with request.app.state.services.database.read() as session:
            versions = list_protocols(session) or [latest_protocol(session)]
            known = {protocol.version: protocol for protocol in versions}
            protocol = known.get(version) or find_protocol(session, version)
            drawing = protocol_drawing(session, protocol)
    except RecordsError as error:
        return refused(request, error)
    content = protocol_page(protocol, versions, drawing)
    return page(request, "protocol.html", "protocol", page=content)


@router.get("/problems")
def show_problems(request: Request) -> Response:
    """List every code."""
    return page(request, "problems.html", "", page=help_index())


@router.get("/problems/{code}")
def show_problem(request: Request, code: str) -> Response:
    """Explain a problem of the API or a fault of a file."""
    problem, fault = find_problem(code), find_fault(code)
    if problem is not None:
        index = help_index() if problem is ProblemCode.FILE_INVALID else None
        help_ = PROBLEM_HELP[problem]
        return page(request, "problem.html", "", code=problem, help=help_, index=index)
    if fault is not None:
        return page(request, "fault.html", "", fault=fault)
    return problem_page(request, 404, ProblemCode.NOT_FOUND, "There is no problem of this name.")


@router.get("/api")
def show_api(request: Request) -> Response:
    """Show the API in one table."""
    groups = operation_groups(request.app.openapi())
    return page(request, "api.html", "api", groups=groups, server=origin_of(request))
