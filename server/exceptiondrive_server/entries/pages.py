"""Routes of the entry page and of the comparison."""

from fastapi import APIRouter, Request
from fastapi.responses import Response
from sqlalchemy.orm import Session

from exceptiondrive_records.db.errors import NotFound
from exceptiondrive_server.boards.entry_facts import entry_key, find_entry
from exceptiondrive_server.boards.pictures import painted_picture
from exceptiondrive_server.boards.query import board_query_of, require_known
from exceptiondrive_server.entries.compare import compare_address, compare_page
from exceptiondrive_server.entries.pictures import badge, entry_picture
from exceptiondrive_server.entries.queries import EntryData, read_comparison, read_entry
from exceptiondrive_server.entries.scenes import Scenes, read_scenes
from exceptiondrive_server.entries.view import entry_page, sample_page
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.browser_session import Elsewhere
from exceptiondrive_server.web.etag import PROXY_KEEPS, conditional
from exceptiondrive_server.web.responses import SECURITY_HEADERS, Values, public_page
from exceptiondrive_server.web.services import Services
from exceptiondrive_server.web.templating import render

router = APIRouter(include_in_schema=False)


@router.get("/entries/{key}")
def show_entry(request: Request, key: str) -> Response:
    """Show an entry as it stands on a board."""
    require_known(request)

    def read(session: Session) -> Values:
        return entry_page(read_entry(session, key, board_query_of(request)))

    return public_page(request, "entries/entry.html", "board", read)


@router.get("/entries/{key}/samples/{place}")
def show_sample(request: Request, key: str, place: str) -> Response:
    """Show one drawn sample of an entry on a public split."""
    require_known(request)

    def read(session: Session) -> Values:
        shown = sample_page(read_entry(session, key, board_query_of(request)), place)
        if shown is None:
            raise NotFound("drawing", place)
        return shown

    return public_page(request, "entries/sample.html", "board", read)


@router.get("/scenes")
def show_scenes(request: Request) -> Response:
    """Show the scenes of a board in motion: its leader, and up to two more entries that are named."""
    require_known(request, "with")
    return public_page(
        request, "entries/scenes.html", "board", lambda it: {"page": _scenes(it, request)}
    )


@router.get("/scenes.svg")
def show_still_scenes(request: Request, services: ServicesOf) -> Response:
    """Show the same as one still picture."""
    with services.database.read() as session:
        scenes = _scenes(session, request)
    body = render("entries/scenes.svg", page=scenes).encode()
    return conditional(request, body, "image/svg+xml", headers=SECURITY_HEADERS)


def _scenes(session: Session, request: Request) -> Scenes:
    keys = [value for key, value in request.query_params.multi_items() if key == "with"]
    return read_scenes(session, board_query_of(request), keys)


@router.get("/badges/{key}.svg")
def show_badge(request: Request, services: ServicesOf, key: str) -> Response:
    """Give the badge of an entry as it stands now."""
    body = badge(_entry(request, services, key))
    headers = {**PROXY_KEEPS, **SECURITY_HEADERS, "Cache-Control": "public, max-age=300"}
    return Response(body, media_type="image/svg+xml", headers=headers)


@router.get("/pictures/entries/{key}.png")
def show_entry_picture(request: Request, services: ServicesOf, key: str) -> Response:
    """Paint an entry as it stands, or stood, on a board."""
    return painted_picture(request, entry_picture(_entry(request, services, key)))


@router.get("/compare")
def show_comparison(request: Request) -> Response:
    """Compare two or more entries of one board; names that were typed become their keys."""
    require_known(request, "a", "b")
    return public_page(
        request, "entries/compare.html", "compare", lambda it: _comparison(it, request)
    )


def _comparison(session: Session, request: Request) -> Values:
    pairs = request.query_params.multi_items()
    reading = read_comparison(session, board_query_of(request), pairs)
    asked = [value for key, value in pairs if key in ("a", "b", "more") and value]
    board = reading.board.board
    if board and any(find_entry(board, value) is None for value in asked):
        kept = [(key, value) for key, value in pairs if key not in ("a", "b", "more")]
        keys = [entry_key(entry) for entry in reading.entries]
        raise Elsewhere(compare_address(kept, keys))
    return compare_page(reading)


def _entry(request: Request, services: Services, key: str) -> EntryData:
    with services.database.read() as session:
        return read_entry(session, key, board_query_of(request))
