"""Pages for signed-in organizers: everything that the API and the command line let them do."""

from fastapi import APIRouter, Depends

from exceptiondrive_server.organizer_pages.audit_routes import router as _audit
from exceptiondrive_server.organizer_pages.frame import organizing
from exceptiondrive_server.organizer_pages.overview_routes import router as _overview
from exceptiondrive_server.organizer_pages.phase_routes import router as _phases
from exceptiondrive_server.organizer_pages.protocol_routes import router as _protocols
from exceptiondrive_server.organizer_pages.run_routes import router as _runs
from exceptiondrive_server.organizer_pages.similarity_routes import router as _similar
from exceptiondrive_server.organizer_pages.submission_routes import router as _submissions
from exceptiondrive_server.organizer_pages.team_routes import router as _teams
from exceptiondrive_server.organizer_pages.team_step_routes import router as _team_steps
from exceptiondrive_server.organizer_pages.verification_routes import router as _verifications

__all__ = ["router"]

router = APIRouter(include_in_schema=False, dependencies=[Depends(organizing)])
for _part in (
    _overview,
    _teams,
    _team_steps,
    _phases,
    _similar,
    _submissions,
    _protocols,
    _runs,
    _verifications,
    _audit,
):
    router.include_router(_part)
