"""Pages are made in a few places of their own: API calls and /healthz never wait behind them."""

from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from threading import Event, Semaphore
from typing import TYPE_CHECKING

import httpx
import pytest
from tests.support.serving import served

from exceptiondrive_server.boards.queries import read_board
from exceptiondrive_server.web.limits.page_places import PAGES_AT_ONCE, PAGES_OF_AN_ADDRESS

if TYPE_CHECKING:
    from tests.support.application import Api

THREADS = 40
"""Of a process, as anyio gives them."""


@pytest.fixture
def address(api: "Api") -> Iterator[str]:
    with served(api.app) as address:
        yield address


class Held:
    """The making of pages, which stops until it may go on.

    Attributes:
        began: Is released by each page that begins to be made.
        go_on: Lets them all go on.
    """

    def __init__(self) -> None:
        self.began, self.go_on = Semaphore(0), Event()

    def await_began(self, number: int, asked: list[Future[int]]) -> None:
        """Return when so many pages have begun to be made.

        Raises:
            AssertionError: If all that were asked for have been answered before, with what.
        """
        for _ in range(number):
            while not self.began.acquire(timeout=0.1):
                answers = [page.exception() or page.result() for page in asked if page.done()]
                assert len(answers) < len(asked), answers

    def answer_of(self, asked: Future[int]) -> int:
        """Return what is answered while no other page begins to be made.

        Raises:
            AssertionError: If one does: what is asked for may then wait for it without end.
        """
        while not asked.done():
            assert not self.began.acquire(timeout=0.1), "a page more than there are places"
        assert not self.began.acquire(blocking=False)
        return asked.result()

    def read_board(self, *arguments: object, **options: object) -> object:
        """Wait, then read a board."""
        self.began.release()
        self.go_on.wait()
        return read_board(*arguments, **options)  # type: ignore[arg-type]


@pytest.fixture
def held(monkeypatch: pytest.MonkeyPatch) -> Iterator[Held]:
    made = Held()
    monkeypatch.setattr("exceptiondrive_server.boards.pages.read_board", made.read_board)
    yield made
    made.go_on.set()


@pytest.fixture
def readers(held: Held) -> Iterator[ThreadPoolExecutor]:
    with ThreadPoolExecutor(2 * THREADS + 1) as readers:
        yield readers
        held.go_on.set()


def ask(url: str, source: str = "127.0.0.1", token: str = "") -> int:
    """Ask for a page from an address of this machine; return the status."""
    with httpx.Client(
        transport=httpx.HTTPTransport(verify=False, local_address=source), timeout=None
    ) as client:
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        return client.get(url, headers=headers).status_code


def test_an_api_call_and_health_answer_while_more_pages_are_asked_for_than_there_are_threads(
    api: "Api", address: str, held: Held, readers: ThreadPoolExecutor
) -> None:
    asked = [
        readers.submit(ask, f"{address}/?page={number + 1}", f"127.0.0.{2 + number % THREADS}")
        for number in range(2 * THREADS)
    ]
    held.await_began(PAGES_AT_ONCE, asked)
    for path in ("/healthz", "/api/v1/submissions"):
        answer = readers.submit(ask, address + path, token=api.tokens["alpha"])
        assert held.answer_of(answer) == 200
    assert not any(page.done() for page in asked)
    held.go_on.set()
    assert {page.result() for page in asked} == {200}


def test_who_asks_for_many_pages_waits_behind_none_but_its_own(
    address: str, held: Held, readers: ThreadPoolExecutor
) -> None:
    asked = [readers.submit(ask, f"{address}/?page={number}") for number in range(2, 12)]
    held.await_began(PAGES_OF_AN_ADDRESS, asked)
    other = readers.submit(ask, f"{address}/status", "127.0.0.2")
    assert held.answer_of(other) == 200
    held.go_on.set()
    assert {page.result() for page in asked} == {200}


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
