"""Applied protocol updates, as the public sees them."""

from typing import Annotated

from fastapi import APIRouter, Path

from exceptiondrive_records.rescoring.views import public_run
from exceptiondrive_schemas.api.problems import ProblemCode
from exceptiondrive_schemas.api.rescoring import PublicRun
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.problems import problem_responses

router = APIRouter(tags=["boards"])


@router.get(
    "/rescoring/{run_id}",
    operation_id="showUpdate",
    responses=problem_responses(ProblemCode.NOT_FOUND),
)
def get_update(
    services: ServicesOf, run_id: Annotated[str, Path(max_length=64, description="of the update")]
) -> PublicRun:
    """Compare every entry before and after a protocol update that was applied."""
    with services.database.read() as session:
        return public_run(session, run_id)
