"""Who the review page answers: this machine, browsers that were let in, people with a name."""

import re
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import httpx
import pytest
from tests.build.deciding import record
from tests.build.shop import make_shop
from tests.support.serving import served
from typer.testing import CliRunner

from exceptiondrive_build.candidates import walk
from exceptiondrive_build.cli import app as command_line
from exceptiondrive_build.records import Kind
from exceptiondrive_build.report import report
from exceptiondrive_build.review_page.app import COOKIE, review_app
from exceptiondrive_build.values import Inspected, Mark
from exceptiondrive_build.workshop import Workshop


@pytest.fixture(scope="module")
def shop(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_shop(tmp_path_factory.mktemp("made"), width_px=64)


class Site:
    def __init__(self, address: str, keys: list[str]) -> None:
        self.address, self.keys, self.open = address, keys, ExitStack()

    def browser(self) -> httpx.Client:
        return self.open.enter_context(
            httpx.Client(base_url=self.address, headers={"Origin": self.address})
        )

    def let_in(self, name: str = "ada") -> httpx.Client:
        client = self.browser()
        assert client.get(f"/open/{self.keys[-1]}").status_code == 303
        assert client.post("/sign-in", data={"name": name}).status_code == 303
        return client


@pytest.fixture
def site(shop: Path) -> Iterator[Site]:
    keys: list[str] = []
    with served(review_app(shop, keys.append)) as address:
        site = Site(address, keys)
        with site.open:
            yield site


ASKED = (
    ("GET", "/"),
    ("GET", "/inspect"),
    ("GET", "/verify"),
    ("POST", "/api/inspect/claim"),
    ("POST", "/api/verify/decide"),
    ("POST", "/api/verify/undo"),
    ("POST", "/api/verify/measure"),
    ("POST", "/api/keep"),
    ("POST", "/api/address"),
    ("POST", "/sign-out"),
)


def test_nothing_is_shown_to_a_browser_that_was_not_let_in(site: Site, shop: Path) -> None:
    picture = next((shop / "images").iterdir()).name
    bodies = {"have": 0, "card": "0", "value": {}}
    for method, path in (*ASKED, ("GET", f"/pictures/{picture}")):
        answer = site.browser().request(method, path, json=bodies if method == "POST" else None)
        told = answer.text if answer.status_code != 303 else answer.headers["location"]
        assert answer.status_code in (403, 422) or told == "/", path
        assert "0 of" not in told
        assert picture not in told


def test_a_browser_of_before_a_restart_is_told_to_sign_in(site: Site) -> None:
    """Sessions end with the process; the page shows the sentence of an answer."""
    before = site.browser()
    before.cookies.set(COOKIE, "a session that ended")
    for path, body in (("inspect/decide", {"card": "0", "value": {}}), ("address", None)):
        answer = before.post(f"/api/{path}", json=body)
        assert answer.status_code == 403
        assert answer.json() == {
            "sentence": "Open the address that the terminal shows, and sign in."
        }


def test_an_address_works_once_and_the_terminal_is_told_the_next(site: Site) -> None:
    first = site.keys[0]
    ada = site.let_in("ada")
    assert "Inspect edits" in ada.get("/").text
    assert site.browser().get(f"/open/{first}").status_code == 403
    assert len(site.keys) == 2
    made = ada.post("/api/address").json()["address"]
    assert made.startswith(f"{site.address}/open/")
    other = site.browser()
    assert other.get(made).status_code == 303
    assert "Who reviews?" in other.get("/").text
    assert other.get("/inspect").headers["location"] == "/"


def test_the_terminal_is_told_the_next_address_although_one_of_the_page_is_unused(
    site: Site,
) -> None:
    ada = site.let_in("ada")
    lost = ada.post("/api/address").json()["address"]
    shown = site.keys[-1]
    site.let_in("grace")
    assert site.keys[-1] != shown
    assert site.browser().get(f"/open/{site.keys[-1]}").status_code == 303
    told = len(site.keys)
    assert site.browser().get(lost).status_code == 303
    assert len(site.keys) == told


def test_a_page_of_another_site_and_another_name_of_this_machine_get_nothing(site: Site) -> None:
    ada = site.let_in()
    body = {"have": 0}
    evil = {"Origin": "https://evil.example"}
    assert ada.post("/api/inspect/claim", json=body, headers=evil).status_code == 403
    assert ada.post("/api/inspect/claim", json=body, headers={"Origin": "null"}).status_code == 403
    assert ada.get("/", headers={"Host": "evil.example"}).status_code == 403
    assert ada.get("/", headers={"Host": "127.0.0.1.evil.example:8400"}).status_code == 403
    assert ada.post("/api/inspect/claim", json=body).status_code == 200


def test_every_answer_forbids_what_the_page_does_not_need(site: Site) -> None:
    for path in ("/", "/static/queue.js", "/open/none"):
        headers = site.browser().get(path).headers
        assert headers["content-security-policy"].startswith(
            "default-src 'none'; script-src 'self'"
        )
        assert headers["x-content-type-options"] == "nosniff"


def test_pictures_of_the_workshop_and_nothing_beside_them_are_sent(site: Site, shop: Path) -> None:
    ada = site.let_in()
    picture = next((shop / "images").iterdir())
    assert ada.get(f"/pictures/{picture.name}").content == picture.read_bytes()
    others = ("none.png", "..%2Fworkshop.toml", "%2e%2e/records.sqlite3", ".", "x" * 3000, "%00")
    for name in others:
        assert ada.get(f"/pictures/{name}").status_code == 404


@pytest.mark.parametrize("name", ["", "   ", "x" * 65, "a\u0000b"])
def test_a_name_is_asked_for_until_it_is_one(site: Site, name: str) -> None:
    client = site.browser()
    client.get(f"/open/{site.keys[-1]}")
    answer = client.post("/sign-in", data={"name": name})
    assert answer.status_code == 422
    assert "at most 64 characters" in answer.text


def test_who_signs_out_is_out(site: Site) -> None:
    ada = site.let_in()
    session = dict(ada.cookies)
    assert ada.post("/sign-out").status_code == 303
    again = site.browser()
    again.cookies.update(session)
    assert again.get("/").status_code == 403


def test_a_word_of_another_form_is_refused_and_not_kept(site: Site) -> None:
    ada = site.let_in()
    (card, *_) = ada.post("/api/inspect/claim", json={"have": 3}).json()["cards"]
    for value in ({"passed": "perhaps"}, {}, {"passed": True, "score": 5}):
        answer = ada.post("/api/inspect/decide", json={"card": card["id"], "value": value})
        assert answer.status_code == 422
        assert answer.json()["sentence"]
    answer = ada.post("/api/inspect/decide", json={"card": "0000", "value": {"passed": True}})
    assert answer.status_code == 409


@pytest.mark.parametrize("form", ["application/json", "text/plain", ""])
@pytest.mark.parametrize(
    "body", [b"\xff\xfe", b"[" * 100_000, b'{"card": "a", "value": NaN}', b'{"card": 1e999}']
)
def test_what_cannot_be_read_is_refused_in_a_sentence(site: Site, body: bytes, form: str) -> None:
    answer = site.let_in().post(
        "/api/verify/decide", content=body, headers={"Content-Type": form} if form else {}
    )
    assert answer.status_code in (400, 422)
    assert answer.json()


def test_the_agreement_of_the_first_page_is_that_of_the_report(shop: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(shop, tmp_path / "shop")
    with served(review_app(folder, (keys := list[str]()).append)) as address:
        site = Site(address, keys)
        with site.open, Workshop(folder) as workshop:
            ada, grace = site.let_in("ada"), site.let_in("grace")
            (card, *_) = ada.post("/api/verify/claim", json={"have": 0}).json()["cards"]
            value = {"accepted": True, "corners": card["corners"], "checked": ["views"]}
            word = {"card": card["id"], "value": value}
            for reader in (ada, grace):
                assert reader.post("/api/verify/decide", json=word).status_code == 200
            pictures = walk(workshop)[card["id"]].pictures
            refused = Inspected(passed=False, reason=Mark.VISIBILITY)
            workshop.records.append(record(Kind.INSPECT, card["id"], "lin", pictures, refused))
            counted = report(workshop).agreement
            assert counted is not None
            assert counted.n == 1
            assert re.search(r"Read by two</dt>\s*<dd>1<", ada.get("/").text)


def test_settings_that_cannot_be_read_are_told_on_the_page_in_a_sentence(
    site: Site, shop: Path
) -> None:
    ada, text = site.let_in(), (shop / "workshop.toml").read_text()
    (shop / "workshop.toml").write_text("[")
    try:
        pages = ada.get("/"), ada.post("/api/inspect/claim", json={"have": 0})
    finally:
        (shop / "workshop.toml").write_text(text)
    assert [page.status_code for page in pages] == [422, 422]
    assert pages[0].text.startswith(f"{shop / 'workshop.toml'}: ")
    assert pages[1].json() == {"sentence": pages[0].text}
    assert ada.get("/").status_code == 200


def test_without_a_workshop_or_a_port_the_command_says_so(tmp_path: Path, shop: Path) -> None:
    said = CliRunner().invoke(command_line, ["review", "-w", str(tmp_path)])
    assert (said.exit_code, "no workshop" in said.output) == (2, True)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        said = CliRunner().invoke(command_line, ["review", "-w", str(shop), "--port", port])
    assert (said.exit_code, f"Port {port}" in said.output) == (2, True)


@contextmanager
def command(shop: Path) -> Iterator[tuple["subprocess.Popen[str]", str]]:
    """The real command in a process of its own, and the address that it shows."""
    call = "from exceptiondrive_build.cli import main; main()"
    line = [sys.executable, "-c", call, "review", "-w", str(shop), "--port", "0"]
    with subprocess.Popen(line, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield process, process.stdout.readline().split()[-1]
        finally:
            process.kill()


def test_a_server_killed_between_two_decisions_has_kept_the_first(
    shop: Path, tmp_path: Path
) -> None:
    folder = shutil.copytree(shop, tmp_path / "shop")
    decided: list[str] = []
    for name in ("ada", "grace"):
        with command(folder) as (process, address):
            host = address.rpartition("/open/")[0]
            with httpx.Client(base_url=host, headers={"Origin": host}) as client:
                assert client.get(address).status_code == 303
                assert client.post("/sign-in", data={"name": name}).status_code == 303
                answer = client.post("/api/inspect/claim", json={"have": 3}).json()
                assert answer["progress"]["decided"] == len(decided)
                card = answer["cards"][0]["id"]
                word = {"card": card, "value": {"passed": True}}
                assert client.post("/api/inspect/decide", json=word).status_code == 200
                decided.append(card)
            process.send_signal(signal.SIGKILL)
    with Workshop(folder) as workshop:
        records = list(workshop.records.read(Kind.INSPECT))
    assert [record.candidate for record in records] == decided
    assert [record.by.person for record in records] == ["ada", "grace"]
