"""Protocol updates, as every reader sees them: the history of boards, and applied updates."""

from typing import Annotated

from fastapi import APIRouter, Path, Query

from exceptiondrive_records.phases.phases import shown_phase
from exceptiondrive_records.rescoring.views import board_history, public_run
from exceptiondrive_schemas.api.problems import ProblemCode
from exceptiondrive_schemas.api.rescoring import BoardHistoryLine, PublicRun
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.problems import problem_responses

router = APIRouter(tags=["boards"])


@router.get(
    "/boards", operation_id="listBoards", responses=problem_responses(ProblemCode.NOT_FOUND)
)
def get_boards(
    services: ServicesOf, phase: Annotated[str, Query(max_length=64, description="id of a phase")]
) -> list[BoardHistoryLine]:
    """List every board that was ever public, newest first: protocol, dates, what changed."""
    with services.database.read() as session:
        return board_history(session, shown_phase(session, phase).id)


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
