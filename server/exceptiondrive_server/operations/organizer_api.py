"""Organizers set the links of the site."""

from fastapi import APIRouter

from exceptiondrive_records.operations.site import set_site_links
from exceptiondrive_schemas.api.site import SiteLinks
from exceptiondrive_server.web.auth import Organizer, ServicesOf

router = APIRouter()


@router.patch("/site", operation_id="changeSiteLinks")
def patch_site(services: ServicesOf, organizer: Organizer, change: SiteLinks) -> SiteLinks:
    """Set links of header and footer; omitted ones stay, empty ones are not shown."""
    with services.database.write() as session:
        links = set_site_links(session, change, actor=organizer.actor)
    services.site_state.forget()
    return links
