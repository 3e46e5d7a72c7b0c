"""Kept pages follow the records: each deed is seen at once, whoever did it, and nobody sees another's."""

import re
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta
from threading import Barrier
from typing import TYPE_CHECKING, Any

import pytest
from starlette.testclient import TestClient
from tests.phases.browsing import visitor
from tests.records.statements import statements

from exceptiondrive_records.protocols.protocols import add_protocol
from exceptiondrive_schemas.protocol import packaged_protocol_toml
from exceptiondrive_server.app import create_app
from exceptiondrive_server.web import kept_pages
from exceptiondrive_server.web import services as of_site
from exceptiondrive_server.web.kept_pages import KeptPages

if TYPE_CHECKING:
    from tests.phases.life import Life

BOARDS = ("/?phase=test", "/", "/?phase=test&sort=-ur", "/?phase=test&q=alpha")
OTHERS = (
    "/entries/{alpha}",
    "/entries/{beta}",
    "/entries/{alpha}?phase=test&board=2",
    "/compare?phase=test",
    "/compare?phase=test&a={beta}&b={alpha}",
    "/scenes?phase=test",
    "/scenes?phase=test&with={beta}",
    "/history?phase=test",
    "/phases/test",
    "/protocols/1.0",
)
Deed = Callable[["Life", dict[str, str]], object]


def apply_run(life: "Life", ids: dict[str, str]) -> None:
    toml = packaged_protocol_toml().replace('version = "1.0"', 'version = "1.1"')
    with life.database.write() as session:
        add_protocol(session, toml, "test")
    life.apply(life.start_run(protocol="1.1"))


def worked(deed: Deed) -> Deed:
    """A deed after which workers build a board."""

    def done(life: "Life", ids: dict[str, str]) -> None:
        deed(life, ids)
        life.work()

    return done


DEEDS: dict[str, Deed] = {
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
def boarded(life: "Life") -> dict[str, str]:
    """A phase with one entry of each of two teams."""
    life.make_phase(split="plain")
    ids = {who: life.submit(who, speed, "Net", "plain") for who, speed in _SPEEDS.items()}
    life.work()
    return ids


_SPEEDS = {"alpha": 1.0, "beta": 9.0}


@pytest.fixture
def other_server(life: "Life") -> Iterator[TestClient]:
    """A second process of the server, in this one."""
    app = create_app(life.server)
    yield TestClient(app, base_url="https://server.test", follow_redirects=False)
    app.state.services.close()


def services(client: TestClient) -> Any:
    return client.app.state.services  # type: ignore[attr-defined]


def _text(client: TestClient, address: str) -> str:
    return re.sub(r'"request_id":"[^"]*"', "", client.get(address).text)


def pages(client: TestClient, ids: dict[str, str]) -> list[str]:
    """What a visitor sees, twice: made or read again, then kept."""
    addresses = [each.format(**ids) for each in (*BOARDS, *OTHERS)]
    read: list[list[str]] = [[_text(client, each) for each in addresses] for _ in range(2)]
    assert read[0] == read[1]
    return read[0]


@pytest.mark.parametrize("what", DEEDS)
def test_each_page_follows_each_deed_at_once_in_every_process(
    life: "Life", other_server: TestClient, boarded: dict[str, str], what: str
) -> None:
    before = pages(life.client, boarded)
    assert pages(other_server, boarded) == before
    DEEDS[what](life, boarded)
    after = pages(life.client, boarded)
    assert after[0] != before[0]
    assert pages(other_server, boarded) == after
    object.__setattr__(services(other_server), "kept_pages", KeptPages())
    assert pages(other_server, boarded) == after, "a page that was kept differs from one made now"


@pytest.mark.parametrize("address", [BOARDS[0], "/entries/{alpha}", *OTHERS[3:]])
def test_an_unchanged_page_asks_the_records_for_their_state_alone(
    life: "Life", boarded: dict[str, str], address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for clock in (kept_pages, of_site):  # a slow machine must not turn it in between
        monkeypatch.setattr(clock, "MAX_AGE_S", 3600.0)
    database = services(life.client).database
    for _ in range(20):
        before = database.state()
        first = life.client.get(address.format(**boarded))
        with statements(database) as asked:
            again = life.client.get(address.format(**boarded))
        if (
            database.state() == before
        ):  # else PostgreSQL vacuumed of itself, which looks like a write
            break
    assert (first.status_code, again.text, len(asked)) == (200, first.text, 1)


def test_what_the_clock_turns_is_looked_at_again(
    life: "Life", boarded: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    life.client.get(BOARDS[0])
    monkeypatch.setattr(kept_pages, "MAX_AGE_S", -1.0)
    with statements(services(life.client).database) as asked:
        life.client.get(BOARDS[0])
    assert len(asked) > 1


def test_what_somebody_who_signed_in_sees_is_kept_for_nobody(
    life: "Life", boarded: dict[str, str]
) -> None:
    public = pages(life.client, boarded)
    for who in ("alpha", "organizer"):
        own = visitor(life, who)
        weight = services(life.client).kept_pages.weight_bytes
        mine = own.get(BOARDS[0])
        assert "My submissions" in mine.text
        assert "content-encoding" not in mine.headers
        assert services(life.client).kept_pages.weight_bytes == weight
        assert pages(life.client, boarded) == public
    assert all("My submissions" not in page and "/organize" not in page for page in public)


def test_a_theme_and_a_host_get_their_own_pages(life: "Life", boarded: dict[str, str]) -> None:
    plain = life.client.get("/").text
    dark = life.client.get("/", headers={"Cookie": "theme=dark"}).text
    foreign = life.client.get("/", headers={"Host": "other.test"}).text
    assert 'data-theme="dark"' in dark
    assert "https://other.test" in foreign
    assert life.client.get("/").text == plain
    assert "other.test" not in plain


def test_any_number_of_addresses_takes_no_more_than_the_room(
    life: "Life", boarded: dict[str, str]
) -> None:
    page_bytes = len(life.client.get("/").content)
    small = KeptPages(room_bytes=4 * page_bytes)
    object.__setattr__(services(life.client), "kept_pages", small)
    for number in range(12):
        assert life.client.get(f"/?page={number + 1}").status_code == 200
        assert small.weight_bytes <= 4 * page_bytes
    assert small.weight_bytes > page_bytes


def test_no_page_waits_for_another_page_to_be_made() -> None:
    kept, number = KeptPages(), 100
    all_read = Barrier(number, timeout=60)

    def read() -> tuple[object, Callable[[], str]]:
        all_read.wait()
        return "value", lambda: "page"

    with ThreadPoolExecutor(number) as readers:
        pages = [
            readers.submit(kept.current, looks, lambda: "state", read) for looks in range(number)
        ]
    assert {page.result().html for page in pages} == {b"page"}
