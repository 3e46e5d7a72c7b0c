"""A page of the longest board stays light."""

import pytest
from benchmarks.page import big_board

from exceptiondrive_schemas.protocol import Protocol
from exceptiondrive_server.boards.page import BoardReading, board_page
from exceptiondrive_server.boards.query import BoardQuery
from exceptiondrive_server.web.page_parts import Site
from exceptiondrive_server.web.responses import render

MAX_BYTES = 150_000


@pytest.mark.parametrize("query", [[], [("q", "planner 1"), ("sort", "ur"), ("page", "3")]])
def test_the_board_of_a_thousand_weighs_less_than_150_kilobytes(
    protocol: Protocol, query: list[tuple[str, str]]
) -> None:
    board = big_board(protocol)
    reading = BoardReading((), None, board, protocol, ("1.0",), "1.0", True)
    site = Site("auto", "/", "board", origin="https://leaderboard.example.org")
    html = render("boards/board.html", site=site, page=board_page(reading, BoardQuery.parse(query)))
    assert 50_000 < len(html.encode()) < MAX_BYTES
