"""Pages for signed-in organizers: everything that the API and the command line let them do."""

from fastapi import APIRouter, Depends

from exceptiondrive_server.audit.organizer_pages import router as _audit
from exceptiondrive_server.operations.organizer_pages import router as _overview
from exceptiondrive_server.phases.organizer_pages import router as _phases
from exceptiondrive_server.protocols.organizer_pages import router as _protocols
from exceptiondrive_server.rescoring.organizer_pages import router as _runs
from exceptiondrive_server.rescoring.verification_pages import router as _verifications
from exceptiondrive_server.submissions.organizer_pages import router as _submissions
from exceptiondrive_server.submissions.organizer_pages import similar_router as _similar
from exceptiondrive_server.teams.organizer_pages import router as _teams
from exceptiondrive_server.teams.organizer_step_pages import router as _team_steps
from exceptiondrive_server.web.organizer_frame import organizing

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
