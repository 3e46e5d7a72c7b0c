"""Boards: the current one, one of a date, each at its permanent address; JSON and CSV."""

from datetime import UTC, date, datetime, time, timedelta
from typing import Annotated

from fastapi import APIRouter, Path, Query, Request
from fastapi.responses import Response
from sqlalchemy.orm import Session

from exceptiondrive_records.boards import board_at, current_board, find_board, latest_board
from exceptiondrive_records.errors import NotFound
from exceptiondrive_records.phases import find_phase, list_phases
from exceptiondrive_records.protocols import find_protocol
from exceptiondrive_records.tables import BoardRow, Phase
from exceptiondrive_schemas.board import Board
from exceptiondrive_schemas.challenges import ChallengeId
from exceptiondrive_schemas.problems import ProblemCode
from exceptiondrive_server.api.board_order import sorted_board
from exceptiondrive_server.auth import ServicesOf
from exceptiondrive_server.etag import conditional
from exceptiondrive_server.pages.exports import EXPORTS
from exceptiondrive_server.problems import ApiProblem, problem_responses

router = APIRouter(tags=["boards"])
_RESPONSES = {
    200: {"model": Board, "description": "The board; its ETag is the digest of its bytes."},
    304: {"description": "Unchanged."},
    **problem_responses(ProblemCode.NOT_FOUND),
}
PhaseQuery = Annotated[str | None, Query(max_length=64, description="id; else the first phase")]
ProtocolQuery = Annotated[
    str | None, Query(max_length=100, description="version or digest; else the one in force")
]
AsOfQuery = Annotated[
    datetime | date | None, Query(description="the board that was public then; a date is its end")
]
SortQuery = Annotated[
    str | None, Query(max_length=64, description="metric key, `-` in front for descending")
]


@router.get("/leaderboard", operation_id="showBoard", response_class=Response, responses=_RESPONSES)
def get_board(
    request: Request,
    services: ServicesOf,
    challenge: ChallengeId | None = None,
    phase: PhaseQuery = None,
    protocol: ProtocolQuery = None,
    as_of: AsOfQuery = None,
    sort: SortQuery = None,
) -> Response:
    """Give a board as JSON; sorting never changes a rank, and rows without a value come last."""
    with services.database.read() as session:
        row = _find(session, challenge, phase, protocol, as_of)
        body = row.body if sort is None else _sorted(row, sort)
    return conditional(
        request, body.encode(), "application/json", max_age_s=services.settings.board_max_age_s
    )


@router.get(
    "/leaderboard.csv",
    operation_id="downloadBoard",
    response_class=Response,
    responses={
        200: {"content": {"text/csv": {}}, "description": "The board as CSV."},
        304: {"description": "Unchanged."},
        **problem_responses(ProblemCode.NOT_FOUND),
    },
)
def get_board_csv(
    request: Request,
    services: ServicesOf,
    challenge: ChallengeId | None = None,
    phase: PhaseQuery = None,
    protocol: ProtocolQuery = None,
    as_of: AsOfQuery = None,
    sort: SortQuery = None,
) -> Response:
    """Give a board as CSV; cells that a spreadsheet would run as formulas are quoted."""
    with services.database.read() as session:
        row = _find(session, challenge, phase, protocol, as_of)
        document = find_protocol(session, row.protocol_digest)
    board = Board.model_validate_json(row.body if sort is None else _sorted(row, sort))
    text = EXPORTS["csv"].write(board, document, str(request.base_url).rstrip("/"))
    max_age_s = services.settings.board_max_age_s
    return conditional(request, text.encode(), EXPORTS["csv"].media_type, max_age_s=max_age_s)


@router.get(
    "/boards/{phase}/{number}",
    operation_id="showBoardByNumber",
    response_class=Response,
    responses=_RESPONSES,
)
def get_board_by_number(
    request: Request,
    services: ServicesOf,
    phase: Annotated[str, Path(max_length=64)],
    number: Annotated[int, Path(ge=1, lt=2**31)],
) -> Response:
    """Give a board at its permanent address; its bytes never change."""
    with services.database.read() as session:
        body = find_board(session, phase, number).body
    return conditional(request, body.encode(), "application/json", max_age_s=31_536_000)


def _find(
    session: Session,
    challenge: ChallengeId | None,
    phase_id: str | None,
    protocol: str | None,
    as_of: datetime | date | None,
) -> BoardRow:
    phase = _phase(session, challenge, phase_id)
    if as_of is not None:
        row = board_at(session, phase.id, _moment(as_of))
    elif protocol is not None:
        row = latest_board(session, phase.id, find_protocol(session, protocol).digest)
    else:
        row = current_board(session, phase.id)
    if row is None:
        raise NotFound("board of the phase", phase.id)
    return row


def _phase(session: Session, challenge: ChallengeId | None, phase_id: str | None) -> Phase:
    if phase_id is not None:
        phase = find_phase(session, phase_id)
        if challenge is not None and phase.challenge != challenge.value:
            raise NotFound(f"phase of the {challenge.value} challenge", phase_id)
        return phase
    phases = list_phases(session, challenge.value if challenge else None)
    if not phases:
        raise NotFound("phase of the challenge", challenge.value if challenge else "any")
    return phases[0]


def _moment(as_of: datetime | date) -> datetime:
    if isinstance(as_of, datetime):
        return as_of if as_of.tzinfo else as_of.replace(tzinfo=UTC)
    return datetime.combine(as_of, time(), UTC) + timedelta(days=1, microseconds=-1)


def _sorted(row: BoardRow, sort: str) -> str:
    board = Board.model_validate_json(row.body)
    try:
        return sorted_board(board, sort).model_dump_json()
    except KeyError:
        detail = f"Sort by one of the board's metrics, for example `ur` or `-hcc`; not {sort!r}."
        raise ApiProblem(ProblemCode.BAD_REQUEST, detail) from None
