"""Teams whose submissions are alike, and teams that probe: reasons to ask, not proof."""

from typing import Annotated

from fastapi import APIRouter, Path, Request
from fastapi.responses import Response

from exceptiondrive_records.phases import find_phase
from exceptiondrive_records.similarity import similarity_report
from exceptiondrive_server.auth import ServicesOf
from exceptiondrive_server.organizer_pages.frame import OrganizerBrowser, organizer_page

router = APIRouter(prefix="/organize/similar", include_in_schema=False)
SHOWN = 100
"""Pairs on the page, the most alike; the command lists them all."""
SHOWN_OF_A_TEAM = 10


@router.get("/{phase_id}")
def show_similar(
    request: Request,
    services: ServicesOf,
    browser: OrganizerBrowser,
    phase_id: Annotated[str, Path(max_length=64)],
) -> Response:
    """Show the report of a phase."""
    with services.database.read() as session:
        title = find_phase(session, phase_id).title
        report = similarity_report(session, phase_id)
    return organizer_page(
        request,
        browser,
        "similar.html",
        "phases",
        title=title,
        report=report,
        pairs=report.pairs[:SHOWN],
        most_of_a_team=SHOWN_OF_A_TEAM,
    )
