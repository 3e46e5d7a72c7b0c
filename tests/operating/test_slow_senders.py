"""Slow senders before the real nginx: they hold no place of others, and a deadline is the first byte's."""

import json
import socket
import ssl
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import timedelta

import httpx
import pytest
from tests.chaos.clients import planning_file
from tests.chaos.topology import PHASE, Topology
from tests.deploy.nginx import Names, Nginx, find_nginx

from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.operations.dump import file_digests
from exceptiondrive_records.phases.changes import update_phase
from exceptiondrive_schemas.api.phase_settings import PhaseChange

pytestmark = [pytest.mark.slow]
AT_ONCE, PER_TEAM = 4, 2
N_SLOW = 32


@dataclass(frozen=True)
class Site:
    """nginx before one server, and new files for it."""

    topology: Topology
    nginx: Nginx
    new_file: Callable[[], bytes]

    def wait_for_uploads(self, number: int) -> None:
        """Wait until so many are under way in the server."""

        def under_way() -> float:
            name = "exceptiondrive_uploads_under_way "
            lines = httpx.get(f"{self.topology.url}/metrics").text.splitlines()
            return next(float(line.removeprefix(name)) for line in lines if line.startswith(name))

        self.topology.wait_until(lambda: under_way() == number, f"{number} uploads")

    def upload(self, team: str, source: str) -> httpx.Response:
        with self.nginx.browser(source) as browser:
            return browser.post(
                "/api/v1/submissions",
                data={"phase": PHASE, "method": "quick"},
                files={"file": ("f.json", self.new_file())},
                headers={"Authorization": f"Bearer {self.topology.tokens[team]}"},
            )


@pytest.fixture(scope="module")
def site() -> Iterator[Site]:
    find_nginx()
    settings = {
        "EXCEPTIONDRIVE_UPLOADS_AT_ONCE": str(AT_ONCE),
        "EXCEPTIONDRIVE_UPLOADS_AT_ONCE_PER_TEAM": str(PER_TEAM),
    }
    with ExitStack() as stack:
        topology = Topology(settings=settings, is_forked=True)
        stack.callback(topology.close)
        names = Names("127.0.0.1")
        stack.callback(names.close)
        nginx = Nginx(names, int(topology.url.rpartition(":")[2]))
        stack.callback(nginx.close)
        speeds_mps = iter(range(1, 10_000))

        def new_file() -> bytes:
            return planning_file(topology.sample_ids, 1 + next(speeds_mps) / 1000)

        yield Site(topology, nginx, new_file)


class SlowUpload:
    """An upload of which nginx and server have the head and nearly all of the body."""

    def __init__(self, site: Site, source: str, token: str | None) -> None:
        headers = {"Connection": "close"}
        if token is not None:
            headers["Authorization"] = f"Bearer {token}"
        request = httpx.Request(
            "POST",
            f"{site.nginx.url}/api/v1/submissions",
            data={"phase": PHASE, "method": "slow"},
            files={"file": ("f.json", site.new_file())},
            headers=headers,
        )
        body = request.read()
        self._rest = body[-100:]
        head = "".join(f"{name}: {value}\r\n" for name, value in request.headers.items())
        trust = ssl.create_default_context(cafile=str(site.nginx.certificate))
        plain = socket.create_connection(
            ("127.0.0.1", site.nginx.port), timeout=60, source_address=(source, 0)
        )
        self.connection = trust.wrap_socket(plain, server_hostname="127.0.0.1")
        self.connection.sendall(f"POST /api/v1/submissions HTTP/1.1\r\n{head}\r\n".encode())
        self.connection.sendall(body[:-100])

    def status(self) -> int:
        """The answer, which comes before the end of the body where it is a refusal."""
        answer = b""
        while b"\r\n" not in answer:
            answer += self.connection.recv(65_536)
        return int(answer.split()[1])

    def finish(self) -> int:
        self.connection.sendall(self._rest)
        return self.status()

    def close(self) -> None:
        self.connection.close()


def slow_uploads(
    site: Site, stack: ExitStack, number: int, source: str, token: str | None
) -> list[SlowUpload]:
    found = [SlowUpload(site, source, token) for _ in range(number)]
    for upload in found:
        stack.callback(upload.close)
    return found


def test_senders_without_a_token_are_sent_away_at_their_head(site: Site) -> None:
    with ExitStack() as stack:
        slow = slow_uploads(site, stack, N_SLOW, "127.0.0.61", None)
        answers = [site.upload("alpha", "127.0.0.62").status_code for _ in range(5)]
        assert answers == [202] * 5
        assert {upload.status() for upload in slow} <= {401, 429}


def test_a_team_that_sends_slowly_holds_its_own_places_alone(site: Site) -> None:
    with ExitStack() as stack:
        token = site.topology.tokens["beta"]
        held = slow_uploads(site, stack, PER_TEAM, "127.0.0.63", token)
        site.wait_for_uploads(PER_TEAM)
        more = slow_uploads(site, stack, N_SLOW, "127.0.0.64", token)
        assert site.upload("alpha", "127.0.0.65").status_code == 202
        assert {upload.status() for upload in more} == {429}
        assert [upload.finish() for upload in held] == [202] * PER_TEAM


def test_uploads_of_all_teams_beyond_what_a_server_takes_are_told_to_come_again(site: Site) -> None:
    with ExitStack() as stack:
        for team, held, together in (("beta", 2, 2), ("gamma", 1, 3), ("delta", 1, AT_ONCE)):
            slow_uploads(site, stack, held, "127.0.0.66", site.topology.tokens[team])
            site.wait_for_uploads(together)
        answer = site.upload("alpha", "127.0.0.67")
        assert (answer.status_code, answer.json()["code"]) == (503, "store_unavailable")
    site.wait_for_uploads(0)
    assert site.upload("alpha", "127.0.0.67").status_code == 202


def test_the_deadline_is_the_first_bytes(site: Site) -> None:
    """The body of one upload comes from before the deadline until after it."""
    token = site.topology.tokens["gamma"]
    with site.topology.database.write() as session:
        closes_at = database_now(session) + timedelta(seconds=4)
        update_phase(session, PHASE, PhaseChange(closes_at=closes_at), actor="test")
    in_time = SlowUpload(site, "127.0.0.68", token)

    def is_closed() -> bool:
        with site.topology.database.read() as session:
            return database_now(session) > closes_at + timedelta(seconds=1)

    while not is_closed():
        time.sleep(0.1)
    late = site.upload("gamma", "127.0.0.68")
    assert (late.status_code, late.json()["code"]) == (403, "phase_closed")
    assert in_time.finish() == 202
    in_time.close()


def test_what_was_refused_left_nothing_in_the_store(site: Site) -> None:
    """Runs with the others or alone: what no record mentions is not there."""
    refused = site.upload("gamma", "127.0.0.69")
    stored = {file.digest for file in site.topology.files.stored()}
    with site.topology.database.read() as session:
        mentioned = set(file_digests(session))
    assert stored <= mentioned, json.dumps(refused.json())
