"""A real server process: quotas under 100 parallel posts, and whom it takes for the sender."""

import os
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import httpx
import pytest
from sqlalchemy import func, select
from tests.support.databases import as_role
from tests.support.processes import free_port
from tests.support.records import add_phase, add_sample_split, found

from exceptiondrive_records.db.database import Database
from exceptiondrive_records.db.roles import Role
from exceptiondrive_records.submissions.tables import Submission

PER_DAY = 7
N_POSTS = 100


@dataclass
class Server:
    """The process, its records, and the token of a team."""

    url: str
    database: Database
    token: str

    def submit(self, content: bytes) -> httpx.Response:
        return httpx.post(
            f"{self.url}/api/v1/submissions",
            headers={"Authorization": f"Bearer {self.token}"},
            data={"phase": "dev", "method": "Planner"},
            files={"file": ("planner.json", content)},
            timeout=120,
        )

    def at_once(self, contents: list[bytes]) -> list[httpx.Response]:
        with ThreadPoolExecutor(len(contents)) as pool:
            return list(pool.map(self.submit, contents))

    def n_submissions(self) -> int:
        with self.database.read() as session:
            return session.scalar(select(func.count()).select_from(Submission)) or 0


@pytest.fixture
def serve(tmp_path: Path) -> Iterator[Callable[..., Server]]:
    """Starts `exceptiondrive-server serve` over a database; keywords are settings."""
    with ExitStack() as stack:

        def start(database_url: str, **settings: str) -> Server:
            database = Database(database_url)
            stack.callback(database.dispose)
            token = _fill(database)
            port = free_port()
            given = {
                "DATABASE_URL": as_role(database_url, Role.API),
                "BROKER_URL": f"redis+socket://{tmp_path}/nobody.sock",
                "FILE_STORE_URL": (tmp_path / "uploads").as_uri(),
                "RECEIPT_KEY_FILE": str(tmp_path / "receipt-key.pem"),
                **settings,
            }
            kept = {k: v for k, v in os.environ.items() if not k.startswith("EXCEPTIONDRIVE_")}
            process = subprocess.Popen(
                [
                    Path(sys.executable).parent / "exceptiondrive-server",
                    "serve",
                    "--port",
                    str(port),
                ],
                env=kept | {f"EXCEPTIONDRIVE_{name}": value for name, value in given.items()},
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
            stack.callback(process.wait)
            stack.callback(process.kill)
            _wait_for(f"http://127.0.0.1:{port}", process)
            return Server(f"http://127.0.0.1:{port}", database, token)

        yield start


def _fill(database: Database) -> str:
    with database.write() as session:
        add_sample_split(session)
        token = found(session).tokens["alpha"]
        add_phase(session, quota_per_day=PER_DAY)
    return token


def _wait_for(url: str, process: "subprocess.Popen[bytes]") -> None:
    deadline = time.monotonic() + 180
    while True:
        try:
            httpx.get(f"{url}/healthz").raise_for_status()
            return
        except httpx.TransportError:
            assert process.poll() is None, "the server did not start"
            assert time.monotonic() < deadline
            time.sleep(0.05)


def test_of_100_parallel_posts_exactly_the_quota_is_admitted(
    serve: Callable[..., Server], database_url: str
) -> None:
    server = serve(
        database_url, UPLOADS_AT_ONCE=str(2 * N_POSTS), UPLOADS_AT_ONCE_PER_TEAM=str(N_POSTS)
    )
    started = datetime.now(UTC)
    answers = server.at_once([f"file {n}".encode() for n in range(N_POSTS)])
    ended = datetime.now(UTC)
    assert Counter(answer.status_code for answer in answers) == {
        202: PER_DAY,
        429: N_POSTS - PER_DAY,
    }
    assert server.n_submissions() == PER_DAY
    midnight = (ended + timedelta(days=1)).replace(hour=0, minute=0, second=0, microsecond=0)
    for answer in answers:
        if answer.status_code == 202:
            continue
        problem: dict[str, Any] = answer.json()
        assert problem["code"] == "quota_exceeded"
        resets_at = datetime.fromisoformat(problem["resets_at"])
        assert resets_at in (midnight, midnight - timedelta(days=1)), (
            "midnight may just have passed"
        )
        wait = timedelta(seconds=int(answer.headers["retry-after"]))
        second = timedelta(seconds=1)
        assert resets_at - ended - second <= wait <= resets_at - started + second


def test_the_same_bytes_in_parallel_are_one_submission_and_cost_one(
    serve: Callable[..., Server], database_url: str
) -> None:
    server = serve(
        database_url, UPLOADS_AT_ONCE=str(2 * N_POSTS), UPLOADS_AT_ONCE_PER_TEAM=str(N_POSTS)
    )
    answers = server.at_once([b"the same"] * N_POSTS)
    assert Counter(answer.status_code for answer in answers) == {202: 1, 200: N_POSTS - 1}
    assert len({answer.json()["id"] for answer in answers}) == 1
    assert server.n_submissions() == 1
    others = server.at_once([f"file {n}".encode() for n in range(PER_DAY)])
    assert Counter(answer.status_code for answer in others) == {202: PER_DAY - 1, 429: 1}
    again = server.submit(b"the same")
    assert (again.status_code, again.json()["is_duplicate"]) == (200, True), "even with none left"


def _register(server: Server, sender: str, n: int) -> int:
    wanted = {"id": f"team-{n}", "name": f"Team {n}", "note": "x"}
    headers = {"X-Forwarded-For": sender}
    return httpx.post(
        f"{server.url}/api/v1/registrations", json=wanted, headers=headers
    ).status_code


def test_behind_a_trusted_proxy_each_sender_has_attempts_of_its_own(
    serve: Callable[..., Server], sqlite_url: str
) -> None:
    server = serve(sqlite_url, SELF_REGISTRATION="true", TRUSTED_PROXIES="127.0.0.0/8")
    assert [_register(server, "203.0.113.1", n) for n in range(6)] == [201] * 5 + [429]
    assert _register(server, "203.0.113.2", 7) == 201
    forged = "198.51.100.9, 203.0.113.1"  # what a sender invents stands left of what proxies add
    assert _register(server, forged, 8) == 429


def test_nobody_else_is_believed_about_the_sender(
    serve: Callable[..., Server], sqlite_url: str
) -> None:
    server = serve(sqlite_url, SELF_REGISTRATION="true", TRUSTED_PROXIES="10.9.9.9")
    assert [_register(server, f"203.0.113.{n}", n) for n in range(6)] == [201] * 5 + [429]
