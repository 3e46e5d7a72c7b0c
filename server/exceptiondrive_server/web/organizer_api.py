"""What organizers do. Every route demands their scope; every change leaves an audit line."""

from fastapi import APIRouter, Depends

from exceptiondrive_records.accounts.tokens import Scope
from exceptiondrive_schemas.problems import ProblemCode
from exceptiondrive_server.accounts import organizer_api as organizer_people
from exceptiondrive_server.audit import organizer_api as organizer_audit
from exceptiondrive_server.phases import organizer_api as organizer_phases
from exceptiondrive_server.rescoring import organizer_api as organizer_protocols
from exceptiondrive_server.rescoring import organizer_api as organizer_rescoring
from exceptiondrive_server.submissions import organizer_api as organizer_similarity
from exceptiondrive_server.submissions import organizer_api as organizer_submissions
from exceptiondrive_server.teams import organizer_api as organizer_teams
from exceptiondrive_server.web.auth import require
from exceptiondrive_server.web.problems import problem_responses

router = APIRouter(
    prefix="/organizer",
    tags=["organizers"],
    dependencies=[Depends(require(Scope.ORGANIZE))],
    responses=problem_responses(
        ProblemCode.NOT_SIGNED_IN,
        ProblemCode.NOT_ALLOWED,
        ProblemCode.NOT_FOUND,
        ProblemCode.CONFLICT,
    ),
)
for module in (
    organizer_teams,
    organizer_people,
    organizer_phases,
    organizer_protocols,
    organizer_rescoring,
    organizer_similarity,
    organizer_submissions,
    organizer_audit,
):
    router.include_router(module.router)
