"""Boards: the current one, one of a date, each at its permanent address; JSON and CSV."""

from typing import Annotated, Any

from fastapi import APIRouter, Path, Request
from fastapi.responses import Response

from exceptiondrive_records.boards.boards import find_board, parsed_board, served_body
from exceptiondrive_records.phases.phases import shown_phase
from exceptiondrive_records.protocols.protocols import find_protocol
from exceptiondrive_records.submissions.edits import newest_edit_at
from exceptiondrive_schemas.board import Board
from exceptiondrive_schemas.method_facts import PhaseFacts
from exceptiondrive_schemas.problems import ProblemCode
from exceptiondrive_server.boards.exports import EXPORTS
from exceptiondrive_server.boards.queries import chosen_board, facts_on
from exceptiondrive_server.boards.query import AskedBoard, documented
from exceptiondrive_server.boards.selection import selected_board
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.etag import FOR_EVER_S, conditional
from exceptiondrive_server.web.problems import problem_responses
from exceptiondrive_server.web.responses import origin_of

router = APIRouter(tags=["boards"])
_UNCHANGED: dict[str, Any] = {"description": "The asker's copy is the current one."}
_RESPONSES: dict[int | str, dict[str, Any]] = {
    200: {"model": Board, "description": "The board; its strong ETag is the digest of its bytes."},
    304: _UNCHANGED,
    **problem_responses(ProblemCode.NOT_FOUND),
}


@router.get(
    "/leaderboard",
    operation_id="showBoard",
    response_class=Response,
    responses=_RESPONSES,
    openapi_extra=documented(),
)
def get_board(request: Request, services: ServicesOf, query: AskedBoard) -> Response:
    """Give a board as JSON; sorting and filters change no rank, rows without a value come last."""
    with services.database.read() as session:
        row = chosen_board(session, query)
        board = parsed_board(row)
        facts = facts_on(session, board)
    shown = selected_board(board, query, facts)
    body = served_body(row) if shown is board else shown.model_dump_json()
    max_age_s = services.settings.board_max_age_s
    return conditional(request, body.encode(), "application/json", max_age_s=max_age_s)


@router.get(
    "/leaderboard.csv",
    operation_id="downloadBoard",
    response_class=Response,
    responses={
        200: {
            "content": {"text/csv": {"schema": {"type": "string"}}},
            "description": "The board as CSV; each line names protocol and split by digest.",
        },
        304: _UNCHANGED,
        **problem_responses(ProblemCode.NOT_FOUND),
    },
    openapi_extra=documented(),
)
def get_board_csv(request: Request, services: ServicesOf, query: AskedBoard) -> Response:
    """Give a board as CSV; cells that a spreadsheet would run as formulas are quoted."""
    with services.database.read() as session:
        row = chosen_board(session, query)
        protocol = find_protocol(session, row.protocol_digest)
        facts = facts_on(session, parsed_board(row))
    csv, board = EXPORTS["csv"], selected_board(parsed_board(row), query, facts)
    text = csv.write(board, protocol, origin_of(request), facts)
    max_age_s = services.settings.board_max_age_s
    return conditional(request, text.encode(), csv.media_type, max_age_s=max_age_s)


@router.get(
    "/leaderboard/facts",
    operation_id="showFacts",
    responses=problem_responses(ProblemCode.NOT_FOUND),
    openapi_extra=documented(),
)
def get_facts(services: ServicesOf, query: AskedBoard) -> PhaseFacts:
    """Give what teams tell of the methods on a board now: type, sensors, map, data, size, speed.

    A board never changes and holds none of it; teams may edit it at any time.
    """
    with services.database.read() as session:
        board = parsed_board(chosen_board(session, query))
        return PhaseFacts(
            phase=board.phase,
            board=board.board,
            changed_at=newest_edit_at(session, board.phase),
            entries=dict(facts_on(session, board)),
        )


@router.get(
    "/boards/{phase}/{number}",
    operation_id="showBoardByNumber",
    response_class=Response,
    responses=_RESPONSES,
)
def get_board_by_number(
    request: Request,
    services: ServicesOf,
    phase: Annotated[str, Path(max_length=64, description="id of a phase")],
    number: Annotated[int, Path(ge=1, lt=2**31, description="of the board")],
) -> Response:
    """Give a board at its permanent address; its bytes never change."""
    with services.database.read() as session:
        body = served_body(find_board(session, shown_phase(session, phase).id, number))
    return conditional(request, body.encode(), "application/json", max_age_s=FOR_EVER_S)
