"""Entries: what a board shows of a submission, and its published score sheet."""

from typing import Annotated

from fastapi import APIRouter, Path
from pydantic import BaseModel
from sqlalchemy.orm import Session

from exceptiondrive_records.boards.boards import boards_with, parsed_board
from exceptiondrive_records.boards.tables import BoardRow
from exceptiondrive_records.db.errors import NotFound
from exceptiondrive_records.phases.phases import find_phase
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.submissions.views import published_sheet
from exceptiondrive_schemas.board import BoardEntry
from exceptiondrive_schemas.problems import ProblemCode
from exceptiondrive_schemas.score_sheet import ScoreSheet
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.problems import problem_responses

router = APIRouter(prefix="/entries", tags=["boards"])


class EntryView(BaseModel):
    """A row of the current board with its score sheet, rounded as the protocol says."""

    phase: str
    board: int
    entry: BoardEntry
    sheet: ScoreSheet


@router.get(
    "/{submission_id}",
    operation_id="showEntry",
    responses=problem_responses(ProblemCode.NOT_FOUND),
)
def get_entry(
    services: ServicesOf,
    submission_id: Annotated[str, Path(max_length=64, description="id of a submission")],
) -> EntryView:
    """Show an entry of a current board or late view; what is on neither is not found."""
    with services.database.read() as session:
        rows, sheet = _published(session, submission_id)
    for row in rows:
        board = parsed_board(row)
        for entry in board.entries:
            if entry.submission_id == submission_id and sheet is not None:
                return EntryView(phase=board.phase, board=board.board, entry=entry, sheet=sheet)
    raise NotFound("entry", submission_id)  # the same whether or not it was submitted


def _published(session: Session, submission_id: str) -> tuple[list[BoardRow], ScoreSheet | None]:
    """Return what shows it now, the board first, and its sheet under the protocol of that board."""
    submission = session.get(Submission, submission_id)
    if submission is None:
        return [], None
    phase = find_phase(session, submission.phase_id)
    shown = (phase.current_board_id, phase.late_board_id)
    rows = boards_with(session, submission_id, shown)
    return rows, published_sheet(session, submission, phase)
