"""Public status of scoring, and the links of the site."""

from fastapi import APIRouter

from exceptiondrive_records.operations.site import site_links
from exceptiondrive_records.operations.status import service_status
from exceptiondrive_schemas.api.site import ServiceStatus, SiteLinks
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.problems import problem_responses

router = APIRouter(tags=["site"])


@router.get("/status", operation_id="showStatus", responses=problem_responses())
def get_status(services: ServicesOf) -> ServiceStatus:
    """Show whether submissions are being scored, how many wait, and how the last days went."""
    with services.database.read() as session:
        return service_status(session)


@router.get("/site", operation_id="showSiteLinks", responses=problem_responses())
def get_site(services: ServicesOf) -> SiteLinks:
    """Get the links to paper, code, citation and contact, as organizers set them."""
    with services.database.read() as session:
        return site_links(session)
