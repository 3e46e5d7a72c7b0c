"""What organizers do. Every route demands their scope; every change leaves an audit line."""

from fastapi import APIRouter, Depends

from exceptiondrive_records.tokens import Scope
from exceptiondrive_schemas.problems import ProblemCode
from exceptiondrive_server.api import (
    organizer_audit,
    organizer_people,
    organizer_phases,
    organizer_protocols,
    organizer_rescoring,
    organizer_similarity,
    organizer_submissions,
    organizer_teams,
)
from exceptiondrive_server.auth import require
from exceptiondrive_server.problems import problem_responses

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
