"""Public pages about the site itself: the status of scoring, and how to cite."""

from fastapi import APIRouter, Request
from fastapi.responses import Response

from exceptiondrive_records.db.errors import NotFound
from exceptiondrive_records.operations.site import site_links
from exceptiondrive_records.operations.status import service_status
from exceptiondrive_records.phases.phases import find_phase
from exceptiondrive_schemas.printable import duration_words
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.responses import page

router = APIRouter(include_in_schema=False)


@router.get("/status")
def show_status(request: Request, services: ServicesOf) -> Response:
    """Show whether submissions are scored now, and how the last days went."""
    with services.database.read() as session:
        now = service_status(session)
        last_title = find_phase(session, now.last_board.phase).title if now.last_board else ""
    return page(
        request,
        "operations/status.html",
        "status",
        now=now,
        last_title=last_title,
        duration=duration_words,
    )


@router.get("/cite")
def show_citation(request: Request, services: ServicesOf) -> Response:
    """Show how to cite the benchmark, where organizers say so."""
    with services.database.read() as session:
        links = site_links(session)
    if not links.citation:
        raise NotFound("page", "cite")
    return page(request, "operations/cite.html", "cite", links=links)
