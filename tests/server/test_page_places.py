"""Pages are made in a few places of their own: API calls and /healthz never wait behind them."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from threading import Event, Semaphore
from typing import TYPE_CHECKING

import httpx
import pytest
from tests.support.serving import served

from exceptiondrive_server.boards.queries import read_board
from exceptiondrive_server.web.page_places import PAGES_AT_ONCE

if TYPE_CHECKING:
    from tests.server.conftest import Api

THREADS = 40
"""Of a process, as anyio gives them."""


@pytest.fixture
def address(api: "Api") -> Iterator[str]:
    with served(api.app) as address:
        yield address


def test_an_api_call_and_health_answer_while_more_pages_are_asked_for_than_there_are_threads(
    api: "Api", address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    go_on, began = Event(), Semaphore(0)

    def held(*arguments: object, **options: object) -> object:
        began.release()
        go_on.wait()
        return read_board(*arguments, **options)  # type: ignore[arg-type]

    monkeypatch.setattr("exceptiondrive_server.boards.pages.read_board", held)
    bearer = {"Authorization": f"Bearer {api.tokens['alpha']}"}
    with ThreadPoolExecutor(2 * THREADS) as readers:
        asked = [
            readers.submit(httpx.get, f"{address}/?page={number}", timeout=60)
            for number in range(1, 2 * THREADS + 1)
        ]
        try:
            for _ in range(PAGES_AT_ONCE):
                began.acquire()
            for path in ("/healthz", "/api/v1/submissions"):
                assert httpx.get(address + path, headers=bearer, timeout=30).status_code == 200
            assert not began.acquire(blocking=False)
            assert not any(page.done() for page in asked)
        finally:
            go_on.set()
    assert {page.result().status_code for page in asked} == {200}


def test_what_no_page_asks_for_leads_to_the_address_without_it(api: "Api") -> None:
    """Else each such address would be a page of its own, made anew."""
    for path in ("/", "/history"):
        answer = api.client.get(f"{path}?phase=dev&zz=1&search=x", follow_redirects=False)
        assert (answer.status_code, answer.headers["location"]) == (308, f"{path}?phase=dev")
    for path, read in {
        "/entries/x": "phase=dev&board=1",
        "/entries/x/samples/1": "phase=dev",
        "/compare": "a=x&b=y&more=z&phase=dev",
        "/scenes": "with=x&phase=dev",
    }.items():
        answer = api.client.get(f"{path}?{read}&zz=1", follow_redirects=False)
        assert (answer.status_code, answer.headers["location"]) == (308, f"{path}?{read}")
        assert api.client.get(f"{path}?{read}", follow_redirects=False).status_code != 308
    assert api.client.get("/?phase=dev", follow_redirects=False).status_code == 200


def test_no_page_of_free_text_is_kept(api: "Api") -> None:
    html = {"Accept": "text/html"}
    api.client.get("/?phase=dev", headers=html)
    weight = api.services.kept_pages.weight_bytes
    answer = api.client.get("/?phase=dev&q=one", headers=html)
    assert answer.status_code == 200
    assert "x-accel-expires" not in answer.headers
    assert (weight > 0, api.services.kept_pages.weight_bytes) == (True, weight)
