"""Pages are kept for a second and made anew after it, each action with them, and nobody sees another's."""

import re
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta
from threading import Barrier, Event, Semaphore
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from tests.phases.browsing import visitor
from tests.records.statements import statements

from exceptiondrive_records.protocols.protocols import add_protocol
from exceptiondrive_schemas.protocol import packaged_protocol_toml
from exceptiondrive_server.web import kept_pages
from exceptiondrive_server.web.kept_pages import KeptPages

if TYPE_CHECKING:
    from tests.phases.life import Beginning, Life

BOARD = "/?phase=test"
ADDRESSES = (
    BOARD,
    "/?phase=test&sort=-ur",
    "/entries/{alpha}",
    "/entries/{beta}",
    "/entries/{alpha}?phase=test&board=1",
    "/compare?phase=test",
    "/compare?phase=test&a={beta}&b={alpha}",
    "/scenes?phase=test",
    "/scenes?phase=test&with={beta}",
    "/history?phase=test",
    "/phases/test",
    "/protocols/1.0",
)
Action = Callable[["Life", dict[str, str]], object]


def apply_run(life: "Life", ids: dict[str, str]) -> None:
    toml = packaged_protocol_toml().replace('version = "1.0"', 'version = "1.1"')
    with life.database.write() as session:
        add_protocol(session, toml, "test")
    life.apply(life.start_run(protocol="1.1"))


def worked(action: Action) -> Action:
    """An action after which workers build a board."""

    def done(life: "Life", ids: dict[str, str]) -> None:
        action(life, ids)
        life.work()

    return done


ACTIONS: dict[str, Action] = {
    "a score": worked(lambda life, ids: life.submit("gamma", 4.0, "New", "plain")),
    "a withdrawal": worked(
        lambda life, ids: life.request(
            "POST", f"/api/v1/submissions/{ids['beta']}/withdraw", "beta"
        )
    ),
    "a title": lambda life, ids: life.change({"title": "Another title"}),
    "its hiding": lambda life, ids: life.change({"visibility": "hidden"}),
    "a second phase": lambda life, ids: life.make_phase("second", split="plain", title="Second"),
    "the deadline": lambda life, ids: life.move(closes_at=life.now()),
    "a freeze": lambda life, ids: life.move(freezes_at=life.now()),
    "a protocol": apply_run,
    "families that wait": lambda life, ids: life.move(families_from=life.now() + timedelta(days=1)),
    "facts": lambda life, ids: life.request(
        "PATCH", f"/api/v1/submissions/{ids['alpha']}", "alpha", json={"facts": {"type": "vla"}}
    ),
}


@pytest.fixture
def beginning() -> "Beginning":
    return "boarded", put_on_a_board


def put_on_a_board(life: "Life") -> dict[str, str]:
    life.make_phase(split="plain")
    ids = {who: life.submit(who, speed, "Net", "plain") for who, speed in _SPEEDS.items()}
    life.work()
    return ids


@pytest.fixture
def boarded(life: "Life") -> dict[str, str]:
    """A phase with one entry of each of two teams."""
    return dict(life.begun)


_SPEEDS = {"alpha": 1.0, "beta": 9.0}


class Clock:
    """What pages take for the time: it stands until it is moved."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.looks = Semaphore(0)

    def monotonic(self) -> float:
        self.looks.release()
        return self.now_s


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """The clock of pages that are kept for a second, as they are in a server."""
    clock = Clock()
    monkeypatch.setattr(kept_pages, "time", SimpleNamespace(monotonic=clock.monotonic))
    monkeypatch.setattr(kept_pages, "MAX_AGE_S", 1.0)
    return clock


def services(life: "Life") -> Any:
    return life.client.app.state.services  # type: ignore[attr-defined]


def pages(life: "Life", ids: dict[str, str]) -> list[str]:
    """What a visitor sees."""
    return [life.client.get(each.format(**ids)).text for each in ADDRESSES]


@pytest.mark.parametrize("what", ACTIONS)
def test_a_board_that_is_made_after_an_action_shows_it(
    life: "Life", boarded: dict[str, str], what: str
) -> None:
    before = life.client.get(BOARD).text
    ACTIONS[what](life, boarded)
    after = life.client.get(BOARD)
    assert _of_no_request(after.text) != _of_no_request(before)
    assert after.status_code == (404 if what == "its hiding" else 200)


def _of_no_request(page: str) -> str:
    return re.sub(r'"request_id":"[^"]*"', "", page)


def test_a_page_is_kept_within_its_age_and_made_anew_after_it(
    life: "Life", boarded: dict[str, str], clock: Clock
) -> None:
    before = pages(life, boarded)
    life.change({"title": "Another title"})
    clock.now_s += 0.99
    with statements(services(life).database) as asked:
        assert pages(life, boarded) == before
    assert not asked
    clock.now_s += 0.02
    after = pages(life, boarded)
    assert all("Another title" in page for page in after[:-1])
    object.__setattr__(services(life), "kept_pages", KeptPages())
    assert pages(life, boarded) == after


def test_a_page_that_is_not_there_is_not_kept(
    life: "Life", boarded: dict[str, str], clock: Clock
) -> None:
    assert life.client.get("/?phase=second").status_code == 404
    life.make_phase("second", split="plain")
    assert life.client.get("/?phase=second").status_code == 200


def test_what_somebody_who_signed_in_sees_is_kept_for_nobody(
    life: "Life", boarded: dict[str, str], clock: Clock
) -> None:
    for who in ("alpha", "organizer"):
        own = visitor(life, who)
        weight = services(life).kept_pages.weight_bytes
        mine = own.get(BOARD)
        assert "My submissions" in mine.text
        assert "content-encoding" not in mine.headers
        assert services(life).kept_pages.weight_bytes == weight
        public = pages(life, boarded)
        assert own.get(BOARD).text == mine.text
        assert all("My submissions" not in page and "/organize" not in page for page in public)


def test_who_signed_in_sees_an_action_though_a_page_is_kept(
    life: "Life", boarded: dict[str, str], clock: Clock
) -> None:
    public, own = life.client.get(BOARD).text, visitor(life, "alpha")
    life.change({"title": "Another title"})
    assert "Another title" in own.get(BOARD).text
    assert life.client.get(BOARD).text == public


def test_a_theme_and_a_host_get_their_own_pages(
    life: "Life", boarded: dict[str, str], clock: Clock
) -> None:
    plain = life.client.get("/").text
    dark = life.client.get("/", headers={"Cookie": "theme=dark"}).text
    foreign = life.client.get("/", headers={"Host": "other.test"}).text
    assert 'data-theme="dark"' in dark
    assert "https://other.test" in foreign
    assert life.client.get("/").text == plain
    assert "other.test" not in plain


def test_any_number_of_addresses_takes_no_more_than_the_room(
    life: "Life", boarded: dict[str, str], clock: Clock
) -> None:
    page_bytes = len(life.client.get("/").content)
    small = KeptPages(room_bytes=4 * page_bytes)
    object.__setattr__(services(life), "kept_pages", small)
    for number in range(12):
        assert life.client.get(f"/?page={number + 1}").status_code == 200
        assert small.weight_bytes <= 4 * page_bytes
    assert small.weight_bytes > page_bytes


def test_no_page_waits_for_another_page_to_be_made() -> None:
    kept, number = KeptPages(), 100
    all_made = Barrier(number, timeout=60)

    def make() -> str:
        all_made.wait()
        return "page"

    with ThreadPoolExecutor(number) as readers:
        pages = [readers.submit(kept.current, looks, make) for looks in range(number)]
    assert {page.result().html for page in pages} == {b"page"}


def test_those_who_wait_for_a_page_find_that_of_the_first_however_long_it_took(
    clock: Clock,
) -> None:
    kept, number, made = KeptPages(), 20, list[str]()
    all_asked = Event()

    def make() -> str:
        assert all_asked.wait(60)
        clock.now_s += 10.0
        made.append("page")
        return f"page {len(made)}"

    with ThreadPoolExecutor(number) as readers:
        pages = [readers.submit(kept.current, "/", make) for _ in range(number)]
        for _ in range(number + 1):  # each looks as it asks, and the first before it makes
            assert clock.looks.acquire(timeout=60)
        all_asked.set()
    assert {page.result().html for page in pages} == {b"page 1"}


def test_a_page_that_failed_is_not_kept(clock: Clock) -> None:
    kept = KeptPages()

    def fail() -> str:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        kept.current("/", fail)
    assert kept.weight_bytes == 0
    assert kept.current("/", lambda: "page").html == b"page"
    assert kept.current("/", fail).html == b"page"
    clock.now_s += 1.0
    with pytest.raises(ZeroDivisionError):
        kept.current("/", fail)
