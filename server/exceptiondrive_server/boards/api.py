"""Boards as JSON and CSV: the current one, the one of a date, and each at its permanent address."""

from typing import Annotated, Any
from urllib.parse import urlencode

from fastapi import APIRouter, Path, Query, Request
from fastapi.responses import Response
from pydantic import Field, TypeAdapter
from sqlalchemy.orm import Session

from exceptiondrive_records.boards.boards import (
    find_board,
    is_told_as_recorded,
    parsed_board,
    served_body,
)
from exceptiondrive_records.boards.tables import BoardRow
from exceptiondrive_records.db.errors import NotFound
from exceptiondrive_records.phases.phases import shown_phase
from exceptiondrive_records.rescoring.views import board_history
from exceptiondrive_records.submissions.edits import edits_of_phase
from exceptiondrive_schemas.api.problems import ProblemCode
from exceptiondrive_schemas.api.rescoring import BoardHistoryLine
from exceptiondrive_schemas.base import in_words
from exceptiondrive_schemas.board import Board
from exceptiondrive_schemas.method_facts import FactsOfBoard, PhaseFacts
from exceptiondrive_server.boards.exports import EXPORTS, file_name_header
from exceptiondrive_server.boards.queries import asked_entries, facts_on, find_chosen_board
from exceptiondrive_server.boards.query import BoardQuery, BoardQueryOf, documented
from exceptiondrive_server.boards.reported import ReportedBoardView, reported_of
from exceptiondrive_server.boards.selection import found_entries, is_as_kept, sort_entries
from exceptiondrive_server.web.auth import (
    TOKEN_IS_OPTIONAL,
    MaybePrincipal,
    ServicesOf,
    sees_hidden,
)
from exceptiondrive_server.web.etag import REVALIDATED, UNCHANGED, conditional
from exceptiondrive_server.web.path_ids import PhaseId
from exceptiondrive_server.web.problems import problem_responses
from exceptiondrive_server.web.responses import origin_of

router = APIRouter(tags=["boards"])
Limit = Annotated[int | None, Query(ge=1, le=1000, description="so many at a time")]
_BEGINS = "where a page begins: taken from the `Link` of the page before"
After = Annotated[
    Annotated[
        str,
        Field(pattern=r"^[1-9][0-9]{0,8}\.[0-9]{1,9}$"),
        in_words("must be taken from the `Link` of the page before"),
    ]
    | None,
    Query(description=_BEGINS),
]
_LINK = {
    "description": 'With `limit`, if more follow: `<ADDRESS>; rel="next"`.',
    "schema": {"type": "string"},
}
_RESPONSES: dict[int | str, dict[str, Any]] = {
    200: {"model": Board, "description": "The board; its strong ETag is the digest of its bytes."},
    304: UNCHANGED,
    **problem_responses(ProblemCode.NOT_FOUND),
}


@router.get(
    "/leaderboard",
    operation_id="showBoard",
    response_class=Response,
    responses={**_RESPONSES, 200: {**_RESPONSES[200], "headers": {"Link": _LINK}}},
    openapi_extra=documented(),
)
def get_board(
    request: Request,
    services: ServicesOf,
    query: BoardQueryOf,
    limit: Limit = None,
    after: After = None,
) -> Response:
    """Get a board as JSON; sorting and filters change no rank, and rows without a value come last.

    `limit` splits it into pages: the header `Link` names the next one (`rel="next"`), always of the
    same board, even if a newer one is current by then. Comparisons are on the first page.
    """
    max_age_s = services.settings.board_max_age_s
    number, _, start = (after or "").partition(".")
    with services.database.read() as session:
        row = (
            _paged_board(session, query, int(number))
            if after
            else find_chosen_board(session, query)
        )
        if is_as_kept(query) and limit is None and after is None:
            return _as_kept(request, row, max_age_s)
        board = parsed_board(row)
        facts = facts_on(session, board)
    part, headers = _page_of(board, query, facts, int(start or 0), limit)
    body = part.model_dump_json().encode()
    return conditional(request, body, "application/json", max_age_s=max_age_s, headers=headers)


def _paged_board(session: Session, query: BoardQuery, number: int) -> BoardRow:
    """The board of the page before; of the late view, which has no number to ask for, if it stands.

    Raises:
        NotFound: There is none, or the late view is another by now.
    """
    if query.view == "main":
        named = {"board": number, "as_of": None, "protocol": None}
        return find_chosen_board(session, query.model_copy(update=named))
    row = find_chosen_board(session, query)
    if row.number != number:
        raise NotFound("late view as it was: begin with its first page; board", str(number))
    return row


def _page_of(
    board: Board, query: BoardQuery, facts: FactsOfBoard, start: int, limit: int | None
) -> tuple[Board, dict[str, str]]:
    """Cut, then filter: what teams tell of their methods may change from page to page, no place does."""
    is_kept = is_as_kept(query)
    whole = board.entries if is_kept else sort_entries(board, board.entries, query.sort)
    left = board.model_copy(update={"entries": tuple(whole[start:])})
    found = found_entries(left, query, facts)
    entries = tuple(found[:limit])
    part = left.model_copy(update={"entries": entries} | ({"comparisons": ()} if start else {}))
    if len(entries) == len(found):
        return part, {}
    end = start + next(n for n, each in enumerate(left.entries, 1) if each is entries[-1])
    named = query.model_copy(
        update={"phase": board.phase, "board": None, "as_of": None, "protocol": None}
    )
    pairs = [*named.pairs(), ("limit", str(limit)), ("after", f"{board.board}.{end}")]
    return part, {"Link": f'</api/v1/leaderboard?{urlencode(pairs, safe=",:")}>; rel="next"'}


def _as_kept(request: Request, row: BoardRow, max_age_s: int | None) -> Response:
    """Give a board as readers get it; bytes that are recorded are not digested again."""
    return conditional(
        request,
        lambda: served_body(row).encode(),
        "application/json",
        etag=row.body_digest.removeprefix("sha256:") if is_told_as_recorded(row) else "",
        max_age_s=max_age_s,
        headers=REVALIDATED if max_age_s is None else None,
    )


@router.get(
    "/leaderboard.csv",
    operation_id="downloadBoard",
    response_class=Response,
    responses={
        200: {
            "content": {"text/csv": {"schema": {"type": "string"}}},
            "description": "The board as CSV; each line names protocol and split by digest.",
        },
        304: UNCHANGED,
        **problem_responses(ProblemCode.NOT_FOUND),
    },
    openapi_extra=documented(),
)
def get_board_csv(request: Request, services: ServicesOf, query: BoardQueryOf) -> Response:
    """Get a board as CSV, without reported rows; cells that a spreadsheet would run as formulas are quoted."""
    with services.database.read() as session:
        board, protocol, facts = asked_entries(session, query)
    csv = EXPORTS["csv"]
    text = csv.write(board, protocol, origin_of(request), facts, "")
    max_age_s, headers = services.settings.board_max_age_s, file_name_header(board, "csv")
    return conditional(request, text.encode(), csv.media_type, max_age_s=max_age_s, headers=headers)


@router.get(
    "/leaderboard/facts",
    operation_id="showFacts",
    responses=problem_responses(ProblemCode.NOT_FOUND),
    openapi_extra=documented(),
)
def get_facts(services: ServicesOf, query: BoardQueryOf) -> PhaseFacts:
    """Get the facts of the methods on a board as they are now: type, sensors, map, data, size, speed.

    Boards never change and do not contain them; teams may edit them at any time.
    """
    with services.database.read() as session:
        board = parsed_board(find_chosen_board(session, query))
        return PhaseFacts(
            phase=board.phase,
            board=board.board,
            changed_at=edits_of_phase(session, board.phase).newest_at,
            entries=dict(facts_on(session, board)),
        )


@router.get(
    "/boards",
    operation_id="listBoards",
    response_class=Response,
    responses={
        200: {
            "model": list[BoardHistoryLine],
            "description": "From when to when each was public.",
            "headers": {"Link": _LINK},
        },
        304: UNCHANGED,
        **problem_responses(ProblemCode.NOT_FOUND),
    },
)
def get_boards(
    request: Request,
    services: ServicesOf,
    phase: Annotated[str, Query(max_length=64, description="id of a phase")],
    limit: Limit = None,
    after: Annotated[int | None, Query(ge=1, lt=2**31, description=_BEGINS)] = None,
) -> Response:
    """List every board that was ever public, newest first: protocol, dates, what changed.

    `limit` splits the list into pages: the header `Link` names the next one (`rel="next"`), with older
    boards, which newer boards do not shift.
    """
    with services.database.read() as session:
        lines = board_history(session, shown_phase(session, phase).id)
    left = lines[-(after or len(lines)) :]
    part = left[:limit]
    headers = {}
    if n_more := len(left) - len(part):
        query = urlencode({"phase": phase, "limit": limit, "after": n_more})
        headers["Link"] = f'</api/v1/boards?{query}>; rel="next"'
    body = TypeAdapter(list[BoardHistoryLine]).dump_json(part, by_alias=True)
    max_age_s = services.settings.board_max_age_s
    return conditional(request, body, "application/json", max_age_s=max_age_s, headers=headers)


@router.get(
    "/boards/{phase}/{number}",
    operation_id="showBoardByNumber",
    response_class=Response,
    responses=_RESPONSES,
)
def get_board_by_number(
    request: Request,
    services: ServicesOf,
    phase: PhaseId,
    number: Annotated[int, Path(ge=1, lt=2**31, description="of the board")],
) -> Response:
    """Get a board at its permanent address; its bytes never change."""
    with services.database.read() as session:
        row = find_board(session, shown_phase(session, phase).id, number)
        return _as_kept(request, row, None)


@router.get(
    "/phases/{phase_id}/reported",
    operation_id="listReportedBoards",
    openapi_extra=TOKEN_IS_OPTIONAL,
    responses=problem_responses(ProblemCode.NOT_FOUND, ProblemCode.NOT_SIGNED_IN),
)
def get_reported_boards(
    services: ServicesOf, principal: MaybePrincipal, phase_id: PhaseId
) -> list[ReportedBoardView]:
    """List external boards of a phase: rows that are never ranked, each with what differs."""
    with services.database.read() as session:
        phase = shown_phase(session, phase_id, with_hidden=sees_hidden(principal))
        return reported_of(session, phase)
