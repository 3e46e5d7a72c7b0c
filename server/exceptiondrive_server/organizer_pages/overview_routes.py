"""The first page of the organizers: what needs attention."""

from fastapi import APIRouter, Request
from fastapi.responses import Response

from exceptiondrive_records.attention import attention
from exceptiondrive_records.rescoring.views import run_view
from exceptiondrive_records.teams import list_teams
from exceptiondrive_server.auth import ServicesOf
from exceptiondrive_server.organizer_pages.frame import OrganizerBrowser, organizer_page
from exceptiondrive_server.organizer_pages.overview_view import overview_view

router = APIRouter(include_in_schema=False)


@router.get("/organize")
def show_overview(request: Request, services: ServicesOf, browser: OrganizerBrowser) -> Response:
    """Show what waits for an organizer, the queue, and the workers."""
    with services.database.read() as session:
        found = attention(session)
        content = overview_view(
            found,
            runs=tuple(run_view(session, run) for run in found.open_runs),
            team_names={team.id: team.name for team in list_teams(session)},
        )
    return organizer_page(request, browser, "overview.html", "overview", page=content)
