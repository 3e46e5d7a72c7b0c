"""External boards beside a phase, as organizers import and withdraw them."""

from typing import Annotated

from fastapi import APIRouter, Path
from pydantic import Field

from exceptiondrive_records.boards.reported import (
    MAX_FILE,
    MAX_TITLE,
    import_board,
    measured_on,
    withdraw_reported_board,
)
from exceptiondrive_records.boards.reported_files import MAX_CITE
from exceptiondrive_records.phases.phases import find_phase
from exceptiondrive_server.boards.reported import ReportedBoardView, reported_of, reported_view
from exceptiondrive_server.web.auth import Organizer, ServicesOf
from exceptiondrive_server.web.forms import Action, Form
from exceptiondrive_server.web.path_ids import PhaseId

router = APIRouter(prefix="/phases/{phase_id}/reported")
ReportedId = Annotated[str, Path(max_length=64, description="id of a reported board")]


class NewReportedBoard(Form):
    """An external board."""

    title: Annotated[str, Field(min_length=1, max_length=MAX_TITLE)]
    cite: Annotated[str, Field(min_length=1, max_length=MAX_CITE)]
    """Where it is found: an address, or a citation."""
    file: Annotated[str, Field(min_length=1, max_length=MAX_FILE)]
    """Text of a CSV file: rows, such as this software exports of a board."""


@router.get("", operation_id="listAllReportedBoards")
def get_reported_boards(services: ServicesOf, phase_id: PhaseId) -> list[ReportedBoardView]:
    """List the imported boards of a phase, withdrawn ones too, the newest first."""
    with services.database.read() as session:
        return reported_of(session, find_phase(session, phase_id), with_withdrawn=True)


@router.post("", operation_id="importReportedBoard", status_code=201)
def post_reported_board(
    services: ServicesOf, organizer: Organizer, phase_id: PhaseId, board: NewReportedBoard
) -> ReportedBoardView:
    """Import the rows of an external board for a phase, all or none; they are never ranked."""
    with services.database.write() as session:
        row = import_board(
            session, phase_id, board.title, board.cite, board.file, actor=organizer.actor
        )
        return reported_view(row, measured_on(session, find_phase(session, phase_id)))


@router.post("/{reported_id}/withdraw", operation_id="withdrawReportedBoard")
def post_withdrawal(
    services: ServicesOf,
    organizer: Organizer,
    phase_id: PhaseId,
    reported_id: ReportedId,
    action: Action,
) -> ReportedBoardView:
    """Withdraw the rows of an external board from a phase; they can be imported again."""
    with services.database.write() as session:
        row = withdraw_reported_board(
            session, phase_id, reported_id, reason=action.reason, actor=organizer.actor
        )
        return reported_view(row, measured_on(session, find_phase(session, phase_id)))
