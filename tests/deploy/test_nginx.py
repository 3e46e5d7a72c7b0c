"""nginx before servers that do not answer: what it says itself. With servers: tests/operating."""

import contextlib
import os
import re
import socket
import ssl
import threading
import time
from collections.abc import Iterator
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import httpx
import pytest
from tests.chaos.users import Users, can_change_user
from tests.deploy.nginx import CONF, Names, Nginx
from tests.support.processes import free_port

from exceptiondrive import ServerError
from exceptiondrive.transport import Transport
from exceptiondrive_schemas.api.problems import PROBLEM_MEDIA_TYPE, Problem, ProblemCode
from exceptiondrive_server.operations.bare_install import replaced
from exceptiondrive_server.web.problem_vocabulary import PROBLEMS
from exceptiondrive_server.web.problems import TOO_LARGE

BROWSER = {"Accept": "text/html,application/xhtml+xml,*/*;q=0.8"}
PLACES = {"pid", "listen", "resolver", "set", "http2", "ssl_certificate", "ssl_certificate_key"}
TOO_MANY_BYTES = b"0" * (18 * 1024 * 1024)


@pytest.fixture(scope="module")
def site() -> Iterator[Nginx]:
    names = Names("127.0.0.1")
    started = Nginx(names, free_port(), user=Users().proxy if can_change_user() else None)
    yield started
    started.close()
    names.close()


@pytest.fixture
def browser(site: Nginx) -> Iterator[httpx.Client]:
    with site.browser("127.0.0.51") as client:
        yield client


def problem_of(answer: httpx.Response) -> Problem:
    assert answer.headers["content-type"] == PROBLEM_MEDIA_TYPE
    problem = Problem.model_validate_json(answer.content)
    assert problem.status == answer.status_code
    assert problem.title == PROBLEMS[problem.code].title
    assert problem.type == f"/problems/{problem.code}"
    assert answer.headers["strict-transport-security"]
    return problem


def test_only_places_differ_from_the_file_of_production(site: Nginx) -> None:
    wanted = CONF.read_text("utf-8").splitlines()
    given = (site.folder / "nginx.conf").read_text("utf-8").splitlines()
    changed = {old.split()[0] for old, new in zip(wanted, given, strict=True) if old != new}
    assert {name for name in changed if not name.endswith(("_temp_path", "_cache_path"))} <= PLACES
    assert len(changed) >= 8


def test_a_line_to_replace_that_is_gone_is_noticed() -> None:
    with pytest.raises(LookupError, match="0 times in"):
        replaced(CONF.read_text("utf-8"), {"no such line": ""})


def test_no_server_is_a_problem_that_asks_to_come_again(browser: httpx.Client) -> None:
    answer = browser.get("/api/v1/me", headers=BROWSER)
    problem = problem_of(answer)
    assert (answer.status_code, problem.code) == (502, ProblemCode.STORE_UNAVAILABLE)
    assert answer.headers["retry-after"] == str(problem.retry_after_s) == "5"
    assert "sent twice counts once" in problem.detail


def test_no_server_is_a_page_for_a_browser(browser: httpx.Client) -> None:
    answer = browser.get("/?phase=<script>", headers=BROWSER)
    assert (answer.status_code, answer.headers["retry-after"]) == (502, "5")
    assert answer.headers["content-type"] == "text/html; charset=utf-8"
    assert f"<h1>{PROBLEMS[ProblemCode.STORE_UNAVAILABLE].title}</h1>" in answer.text
    assert "No server answers right now." in answer.text
    assert "script" not in answer.text
    style = browser.get("/refusal.css")
    assert style.headers["content-type"].startswith("text/css")
    assert "style" not in re.sub(r'rel="stylesheet"', "", answer.text), "the policy allows no other"
    assert "style-src 'self'" in answer.headers["content-security-policy"]


def test_the_client_tries_again_and_then_says_what_to_do(
    site: Nginx, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SSL_CERT_FILE", str(site.certificate))
    monkeypatch.setattr("exceptiondrive.transport.retry_after_s", lambda response: 0.0)
    transport = Transport(site.url, None, attempts=3)
    with pytest.raises(ServerError, match="No server answers right now") as caught:
        transport.get("/me")
    transport.close()
    assert caught.value.advice == "Wait a little and run the same command again."
    assert site.log.count("GET /api/v1/me") >= 3


def test_the_log_holds_no_address_that_is_a_secret(site: Nginx, browser: httpx.Client) -> None:
    for path in (
        "/contacts/a/confirm?key=hush",
        "/join/b.hush",
        "/sign-in/callback?code=hush",
        "/sign-in?back=%2Fjoin%2Fb.hush",
    ):
        assert browser.get(path, headers=BROWSER).status_code == 502
    assert browser.get("/history?phase=told", headers=BROWSER).status_code == 502
    assert ("hush" in site.log, "GET /history?phase=told" in site.log) == (False, True)


@pytest.mark.parametrize("path", ["/api/v1/submissions", "/submit"])
def test_a_body_beyond_the_limit_is_refused_in_words(browser: httpx.Client, path: str) -> None:
    answer = browser.post(path, content=TOO_MANY_BYTES)
    assert answer.status_code == HTTPStatus.REQUEST_ENTITY_TOO_LARGE
    problem = problem_of(answer)
    assert (problem.code, problem.detail) == (ProblemCode.UPLOAD_TOO_LARGE, TOO_LARGE)
    assert "retry-after" not in answer.headers
    page = browser.post(path, content=TOO_MANY_BYTES, headers=BROWSER)
    assert ("<h1>" in page.text) is (path == "/submit")


def test_metrics_are_not_for_the_world(browser: httpx.Client) -> None:
    answer = browser.get("/metrics")
    assert problem_of(answer).code is ProblemCode.NOT_FOUND
    assert answer.status_code == 404


def test_http_leads_to_https(site: Nginx) -> None:
    answer = httpx.post(f"http://127.0.0.1:{site.plain_port}/sign-in?next=/a%20b")
    assert answer.status_code == 308, "so that a POST stays one"
    assert answer.headers["location"] == "https://127.0.0.1/sign-in?next=/a%20b"


def test_too_many_requests_of_one_address_and_others_are_served(site: Nginx) -> None:
    with site.browser("127.0.0.52") as flood, site.browser("127.0.0.53") as other:
        answers = (flood.get("/api/v1/me") for _ in range(2000))
        refused = next(answer for answer in answers if answer.status_code != 502)
        assert other.get("/api/v1/me").status_code == 502
    problem = problem_of(refused)
    assert (refused.status_code, problem.code) == (429, ProblemCode.TOO_MANY_REQUESTS)
    assert refused.headers["retry-after"] == str(problem.retry_after_s) == "5"
    assert "Nothing was taken" in problem.detail


@pytest.mark.parametrize(("name", "sender"), [("q", "127.0.0.54"), ("%71", "127.0.0.56")])
def test_searches_of_one_address_have_a_limit_of_their_own(
    site: Nginx, name: str, sender: str
) -> None:
    """Each is a page that nobody keeps; what else the address asks for is answered still."""
    with site.browser(sender) as flood, site.browser("127.0.0.55") as other:
        asked = [flood.get(f"/?sort=ur&{name}={number}").status_code for number in range(30)]
        assert (asked[0], asked.count(429) > 0) == (502, True)
        assert flood.get("/?sort=ur").status_code == 502
        assert other.get("/?q=1").status_code == 502


def test_a_new_certificate_is_served_after_a_reload(site: Nginx) -> None:
    address = ("127.0.0.1", site.port)
    before = ssl.get_server_certificate(address)
    site.renew_certificate()
    assert ssl.get_server_certificate(address) == before
    site.reload()
    wanted = site.certificate.read_text().strip()
    while ssl.get_server_certificate(address).strip() != wanted:
        time.sleep(0.05)  # an old process may still answer; pytest's own time limit ends it


def test_it_runs_without_rights(site: Nginx) -> None:
    assert os.getuid() != 0 or site.folder.stat().st_uid == Users().proxy
    assert "[emerg]" not in site.log
    assert "[alert]" not in site.log


@pytest.fixture(scope="module")
def hasty_site() -> Iterator[Nginx]:
    """The file of production with its two time-outs against slow clients cut to a second."""
    names = Names("127.0.0.1")
    cut = {f"client_{name}_timeout {seconds}s;": f"client_{name}_timeout 1s;"
           for name, seconds in (("header", 10), ("body", 30))}  # fmt: skip
    started = Nginx(names, free_port(), more=cut)
    yield started
    started.close()
    names.close()


def until_closed(connection: socket.socket) -> bytes:
    """All that nginx says, until it is nginx who closes."""
    parts = []
    with connection, contextlib.suppress(ConnectionResetError):
        while part := connection.recv(65_536):
            parts.append(part)
    return b"".join(parts)


@pytest.mark.row("I16")
def test_silent_and_slow_connections_are_ended_and_others_are_served(hasty_site: Nginx) -> None:
    slow = []
    for number in range(36):
        port = hasty_site.plain_port if number % 2 else hasty_site.port
        connection = socket.create_connection(
            ("127.0.0.1", port), timeout=30, source_address=(f"127.0.0.{60 + number}", 0)
        )
        if number % 4 == 1:
            connection.sendall(b"GET / HTTP/1.1\r\nHost: x\r\nX-Drip: ")
        slow.append(connection)
    with hasty_site.browser("127.0.0.57") as other:
        assert [other.get("/api/v1/me").status_code for _ in range(20)] == [502] * 20
    answers = [until_closed(connection) for connection in slow]
    assert not any(answer.startswith(b"HTTP/1.1 200") for answer in answers)


@pytest.mark.row("I16")
def test_a_body_that_stops_coming_reaches_no_server(hasty_site: Nginx) -> None:
    """But an upload, which the server itself ends: tests/hostile/test_connections.py."""
    plain = socket.create_connection(("127.0.0.1", hasty_site.port), timeout=30)
    trust = ssl.create_default_context(cafile=str(hasty_site.certificate))
    with trust.wrap_socket(plain, server_hostname="127.0.0.1") as connection:
        connection.sendall(
            b"POST /api/v1/registrations HTTP/1.1\r\nHost: x\r\nContent-Length: 1000\r\n\r\n0"
        )
        assert not until_closed(connection).startswith(b"HTTP/1.1 5"), "it was passed on"


@pytest.mark.row("I28")
@pytest.mark.parametrize(
    "head", [b"GET / HTTP/1.1\r\nHost: x\r\nX: ", b"GET /"], ids=["header", "address"]
)
def test_an_endless_head_is_refused(hasty_site: Nginx, head: bytes) -> None:
    connection = socket.create_connection(("127.0.0.1", hasty_site.plain_port), timeout=30)
    with contextlib.suppress(OSError):
        connection.sendall(head + b"a" * 2**20)
    answer = until_closed(connection)
    assert answer == b"" or answer.startswith((b"HTTP/1.1 400", b"HTTP/1.1 414"))


@pytest.mark.row("I28")
@pytest.mark.parametrize(
    ("request_line", "status"),
    [
        pytest.param(b"GET /x%00 HTTP/1.1", 400, id="nul"),
        pytest.param(b"GET /" + b"a" * 9_000 + b" HTTP/1.1", 414, id="long-address"),
        pytest.param(b"GET / HTTP/1.1\r\nX: " + b"a" * 40_000, 400, id="long-header"),
        pytest.param(b"GET /a/../../b HTTP/1.1", 400, id="above-the-root"),
        pytest.param(b"CONNECT x:443 HTTP/1.1", 400, id="connect"),
        pytest.param(b"GET /unreadable HTTP/1.1", 404, id="its-own-address"),
    ],
)
def test_what_cannot_be_read_is_a_problem_in_words(
    site: Nginx, request_line: bytes, status: int
) -> None:
    plain = socket.create_connection(("127.0.0.1", site.port), timeout=30)
    trust = ssl.create_default_context(cafile=str(site.certificate))
    with trust.wrap_socket(plain, server_hostname="127.0.0.1") as connection:
        connection.sendall(request_line + b"\r\nHost: x\r\nConnection: close\r\n\r\n")
        head, _, body = until_closed(connection).partition(b"\r\n\r\n")
    assert head.startswith(b"HTTP/1.1 %d " % status), head
    assert b"content-type: application/problem+json" in head.lower()
    problem = Problem.model_validate_json(body)
    assert (problem.status, problem.title) == (status, PROBLEMS[problem.code].title)


class SaysWhomItIsAskedAs(BaseHTTPRequestHandler):
    """A page that names the host it is asked under, as those do where no public address is set."""

    def do_GET(self) -> None:
        body = self.headers["Host"].encode()
        self.send_response(HTTPStatus.OK)
        self.send_header("Cache-Control", "public, max-age=60")
        self.send_header("X-Request-ID", self.headers.get("X-Request-ID", ""))
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: object) -> None: ...


@pytest.fixture
def named_site() -> Iterator[Nginx]:
    server = ThreadingHTTPServer(("127.0.0.1", 0), SaysWhomItIsAskedAs)
    threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True).start()
    names = Names("127.0.0.1")
    started = Nginx(names, server.server_port)
    yield started
    started.close()
    names.close()
    server.shutdown()
    server.server_close()


class AnswersAsTold(BaseHTTPRequestHandler):
    """Answers with the status and body that stand in the server, for a second to be kept."""

    server: "Told"

    def do_GET(self) -> None:
        status, body = self.server.answer
        self.send_response(status)
        if status != HTTPStatus.SERVICE_UNAVAILABLE:
            self.send_header("X-Accel-Expires", "1")
        self.send_header("Cache-Control", "no-store")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: object) -> None: ...


class Told(ThreadingHTTPServer):
    answer = (HTTPStatus.OK, b"the board")


@pytest.fixture
def told_site() -> Iterator[tuple[Told, Nginx]]:
    server = Told(("127.0.0.1", 0), AnswersAsTold)
    threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True).start()
    names = Names("127.0.0.1")
    started = Nginx(names, server.server_port)
    yield server, started
    started.close()
    names.close()
    server.shutdown()
    server.server_close()


def test_what_is_kept_is_shown_while_the_database_is_away_and_what_was_hidden_is_not(
    told_site: tuple[Told, Nginx],
) -> None:
    """A 404 takes the place of what stood there: only because it may be kept as long."""
    server, nginx = told_site
    with nginx.browser() as browser:

        def until(status: int, text: str) -> None:
            deadline = time.monotonic() + 30
            while (found := browser.get("/phases/test")).status_code != status:
                assert time.monotonic() < deadline
                time.sleep(0.1)
            assert found.text == text

        def away_for_s(seconds: float) -> tuple[int, str]:
            server.answer = (HTTPStatus.SERVICE_UNAVAILABLE, b"away")
            time.sleep(seconds)
            found = browser.get("/phases/test")
            return found.status_code, found.text

        until(200, "the board")
        assert away_for_s(2.5) == (200, "the board")
        server.answer = (HTTPStatus.NOT_FOUND, b"nothing here")
        until(404, "nothing here")
        assert away_for_s(2.5) == (404, "nothing here")


def test_what_is_kept_for_one_host_was_asked_under_it(named_site: Nginx) -> None:
    """A request in the absolute form names two; readers of one get nothing that names the other."""
    trust = ssl.create_default_context(cafile=str(named_site.certificate))
    answers = []
    for target in (b"https://evil.example/api", b"/api"):
        plain = socket.create_connection(("127.0.0.1", named_site.port), timeout=30)
        with trust.wrap_socket(plain, server_hostname="127.0.0.1") as connection:
            connection.sendall(
                b"GET %s HTTP/1.1\r\nHost: good.example\r\nConnection: close\r\n\r\n" % target
            )
            answers.append(until_closed(connection).partition(b"\r\n\r\n")[2])
    assert answers == [b"evil.example", b"good.example"]


def test_the_id_of_a_request_is_the_proxys_own(named_site: Nginx) -> None:
    """One that a visitor chose would be kept, and given to everybody who asks the same."""
    trust = ssl.create_default_context(cafile=str(named_site.certificate))
    with httpx.Client(base_url=f"https://127.0.0.1:{named_site.port}", verify=trust) as browser:
        chosen = browser.get("/a", headers={"X-Request-ID": "chosen-by-a-visitor"})
        kept = browser.get("/a")
    ids = [answer.headers.get_list("x-request-id") for answer in (chosen, kept)]
    assert all(len(one) == 1 and len(one[0]) == 32 for one in ids)
    assert ids[0] != ids[1]
