"""Pages for signed-in organizers: everything that the API and the command line let them do."""

from fastapi import APIRouter, Depends

from exceptiondrive_server.organizer_pages.audit_routes import router as _audit
from exceptiondrive_server.organizer_pages.frame import organizing
from exceptiondrive_server.organizer_pages.overview_routes import router as _overview
from exceptiondrive_server.organizer_pages.submission_routes import router as _submissions

__all__ = ["router"]

router = APIRouter(include_in_schema=False, dependencies=[Depends(organizing)])
for _part in (_overview, _submissions, _audit):
    router.include_router(_part)
