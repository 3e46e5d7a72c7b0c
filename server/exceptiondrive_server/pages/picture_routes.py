"""Routes of the pictures that other sites show beside a link."""

from fastapi import APIRouter, Request
from fastapi.responses import Response

from exceptiondrive_server.auth import ServicesOf
from exceptiondrive_server.etag import conditional
from exceptiondrive_server.pages.board_query import AskedBoard
from exceptiondrive_server.pages.entry_readings import read_entry
from exceptiondrive_server.pages.pictures import (
    board_picture,
    entry_picture,
    painted,
    picture_tag,
)
from exceptiondrive_server.pages.readings import read_board
from exceptiondrive_server.pages.responses import SECURITY_HEADERS

router = APIRouter(include_in_schema=False)


@router.get("/pictures/board.png")
def show_board_picture(request: Request, services: ServicesOf, query: AskedBoard) -> Response:
    """Paint a board: the one named, else the current one of the first phase."""
    with services.database.read() as session:
        reading = read_board(session, query)
    return _picture(request, board_picture(reading))


@router.get("/pictures/entries/{key}.png")
def show_entry_picture(
    request: Request, services: ServicesOf, query: AskedBoard, key: str
) -> Response:
    """Paint an entry as it stands, or stood, on a board."""
    with services.database.read() as session:
        reading = read_entry(session, key, query)
    return _picture(request, entry_picture(reading))


def _picture(request: Request, svg: str) -> Response:
    """Answer with the picture; one that the reader has is not painted again."""
    headers = {**SECURITY_HEADERS, "Cache-Control": "public, max-age=300"}
    return conditional(
        request, lambda: painted(svg), "image/png", etag=picture_tag(svg), headers=headers
    )
