"""Routes of the entry page and of the comparison."""

from fastapi import APIRouter, Request
from fastapi.responses import Response

from exceptiondrive_records.db.errors import NotFound, RecordsError
from exceptiondrive_server.boards.pictures import badge_of
from exceptiondrive_server.boards.queries import read_board
from exceptiondrive_server.boards.query import BoardQuery
from exceptiondrive_server.entries.compare import chosen_entries, compare_page, wanted_keys
from exceptiondrive_server.entries.facts import entry_key, entry_url
from exceptiondrive_server.entries.queries import read_entry, read_sheets
from exceptiondrive_server.entries.sample_drawings import drawn_groups, sample_page
from exceptiondrive_server.entries.view import entry_page
from exceptiondrive_server.web.responses import SECURITY_HEADERS, page, refused, render

router = APIRouter(include_in_schema=False)


@router.get("/entries/{key}")
def show_entry(request: Request, key: str) -> Response:
    """Show an entry as it stands on a board."""
    query = BoardQuery.parse(request.query_params.multi_items())
    try:
        with request.app.state.services.database.read() as session:
            reading = read_entry(session, key, query)
    except RecordsError as error:
        return refused(request, error)
    return page(request, "entries/entry.html", "board", page=entry_page(reading))


@router.get("/entries/{key}/samples/{place}")
def show_sample(request: Request, key: str, place: str) -> Response:
    """Show one drawn sample of an entry on a public split."""
    query = BoardQuery.parse(request.query_params.multi_items())
    try:
        with request.app.state.services.database.read() as session:
            reading = read_entry(session, key, query)
        groups = drawn_groups(
            reading.drawings, reading.board, reading.entry, reading.protocol, reading.is_current
        )
        sample = sample_page(groups, place, reading.board, reading.protocol)
        if sample is None:
            raise NotFound("drawing", place)
    except RecordsError as error:
        return refused(request, error)
    url = entry_url(reading.entry, reading.board, reading.is_current)
    return page(
        request, "entries/sample.html", "board", reading=reading, page=sample, entry_url=url
    )


@router.get("/badges/{key}.svg")
def show_badge(request: Request, key: str) -> Response:
    """Give the badge of an entry as it stands now."""
    query = BoardQuery.parse(request.query_params.multi_items())
    try:
        with request.app.state.services.database.read() as session:
            reading = read_entry(session, key, query)
    except RecordsError as error:
        return refused(request, error)
    body = render("boards/badge.svg", badge=badge_of(reading))
    headers = {**SECURITY_HEADERS, "Cache-Control": "public, max-age=300"}
    return Response(body, media_type="image/svg+xml", headers=headers)


@router.get("/compare")
def show_comparison(request: Request) -> Response:
    """Compare two or more entries of one board."""
    query = BoardQuery.parse(request.query_params.multi_items())
    a, b, more = wanted_keys(request.query_params.multi_items())
    try:
        with request.app.state.services.database.read() as session:
            reading = read_board(session, query)
            entries = chosen_entries(reading, a, b, more)
            keys = [entry_key(entry) for entry in entries[:2]]
            sheets = read_sheets(session, reading.board, keys) if reading.board else {}
        content = compare_page(reading, entries, sheets)
    except RecordsError as error:
        return refused(request, error)
    return page(request, "entries/compare.html", "compare", page=content)
