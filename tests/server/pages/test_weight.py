"""A page of the longest board stays light."""

from functools import partial
from typing import Any

import pytest
from benchmarks.page import big_board, calls_in, forget_shown_boards
from starlette.requests import Request

from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_server.boards.page import BoardPage
from exceptiondrive_server.boards.pages import show_board
from exceptiondrive_server.boards.query import BoardQuery
from exceptiondrive_server.web import kept_pages
from exceptiondrive_server.web import services as of_site
from exceptiondrive_server.web.kept_pages import KeptPages
from exceptiondrive_server.web.responses import Site
from exceptiondrive_server.web.templating import render

MAX_BYTES = 150_000
MAX_CALLS, MAX_CALLS_AGAIN, MAX_CALLS_KEPT = 9_000, 1_000, 40
MAX_FILES, MAX_FILES_AGAIN, MAX_FILES_KEPT = 47, 32, 9
"""Of the making of a page, without those that answer with one that is kept; and those."""


@pytest.mark.parametrize("query", [[], [("q", "planner 1"), ("sort", "ur"), ("page", "3")]])
def test_the_board_of_a_thousand_weighs_less_than_150_kilobytes(
    protocol: ProtocolDocument, query: list[tuple[str, str]]
) -> None:
    board = big_board(protocol)
    page = BoardPage(BoardQuery.parse(query), (), None, board, protocol, ("1.0",), "1.0")
    site = Site("auto", "/", "board", origin="https://leaderboard.example.org")
    html = render("boards/board.html", site=site, page=page, own=None, wheel=None)
    assert 50_000 < len(html.encode()) < MAX_BYTES


def test_the_making_of_a_page_grows_no_faster_than_its_board(protocol: ProtocolDocument) -> None:
    calls = {}
    for n_entries in (200, 800):
        page = BoardPage(
            BoardQuery.parse([]),
            (),
            None,
            big_board(protocol, n_entries),
            protocol,
            ("1.0",),
            "1.0",
        )
        site = Site("auto", "/", "board")
        made = partial(render, "boards/board.html", site=site, page=page, own=None, wheel=None)
        calls[n_entries] = calls_in(made).total()
    assert calls[800] < 4.4 * calls[200]


def test_the_board_page_is_made_by_few_calls_in_few_files(
    lively_site: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    for clock in (kept_pages, of_site):  # a slow machine must not turn it in between
        monkeypatch.setattr(clock, "MAX_AGE_S", 3600.0)
    scope = {"type": "http", "method": "GET", "path": "/", "query_string": b"", "headers": []}
    request = Request({**scope, "app": lively_site.app, "server": ("site.test", 80)})
    services = lively_site.app.state.services

    def ask() -> None:
        assert show_board(request).status_code == 200

    def ask_anew() -> None:
        services.kept_pages = KeptPages()
        ask()

    ask()  # a server has compiled its templates when it starts
    kept = calls_in(ask)
    again = calls_in(ask_anew)
    forget_shown_boards()
    first = calls_in(ask_anew)
    assert kept.total() < MAX_CALLS_KEPT
    assert len(kept) <= MAX_FILES_KEPT
    assert first.total() < MAX_CALLS
    assert len(first.keys() - kept.keys()) <= MAX_FILES
    assert again.total() < MAX_CALLS_AGAIN
    assert len(again.keys() - kept.keys()) <= MAX_FILES_AGAIN
