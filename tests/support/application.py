"""The real application over a real, migrated database and a real file store.

No broker answers at the address given: uploads must be accepted all the same.
"""

import re
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
import structlog
from fastapi import FastAPI
from sqlalchemy import select
from starlette.testclient import TestClient
from tests.support.databases import as_role
from tests.support.documents import make_board, make_sheet
from tests.support.records import Founded, add_phase, add_sample_split, found
from tests.support.snapshots import Snapshots
from tests.support.work import claim_board_of, claim_this

from exceptiondrive_records.audit.tables import AuditLine
from exceptiondrive_records.boards.boards import publish_board
from exceptiondrive_records.boards.tables import BoardRow
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.db.roles import Role
from exceptiondrive_records.work import jobs
from exceptiondrive_records.work.board_requests import want_board
from exceptiondrive_records.work.lease import claim_oldest
from exceptiondrive_records.work.profiles import finish_profile
from exceptiondrive_records.work.tables import Job, Profile
from exceptiondrive_schemas.board import BoardEntry, EntrySource, FamilyHead
from exceptiondrive_schemas.faults import CheckReport
from exceptiondrive_schemas.protocol import packaged_protocol
from exceptiondrive_schemas.score_sheet import ProtocolRef, ScoreSheet
from exceptiondrive_server import app as application
from exceptiondrive_server.app import create_app
from exceptiondrive_server.web.openapi import describe
from exceptiondrive_server.web.services import Services
from exceptiondrive_server.web.settings import ServerSettings

PROTOCOL = packaged_protocol()
PREFIX = "/api/v1"
MAX_UPLOAD_BYTES = 64 * 1024
METRICS: dict[str, float | None] = {
    "hcc": 0.5,
    "ur": 0.25,
    "hpr": 0.4,
    "cts": 1.5,
    "cts_x": 1.0,
    "cts_y": None,
}


def entry(
    method: str,
    *,
    source: EntrySource = "scored",
    rank: int | None = 1,
    submission_id: str | None = None,
    team: str = "Alpha",
    **metrics: float | None,
) -> BoardEntry:
    row = {**METRICS, **metrics}
    return BoardEntry(
        source=source,
        rank=rank,
        rank_interval=None if rank is None else (rank, rank),
        submission_id=submission_id,
        method=method,
        team=team,
        submitted_at=datetime(2026, 11, 20, tzinfo=UTC),
        metrics=row,
        micro=row,
        macro_family=row,
        intervals={"hcc": (0.4, 0.6)},
        families={},
    )


def sheet(hcc: float = 0.5) -> ScoreSheet:
    row = {**METRICS, "hcc": hcc}
    return make_sheet(PROTOCOL.digest, row)


_DESCRIPTION: dict[str, Any] = {}


def described(app: FastAPI) -> dict[str, Any]:
    """Return the OpenAPI document, which is the same of every application: made once, in 0.7 s."""
    if not _DESCRIPTION:
        _DESCRIPTION.update(describe(app))
    return _DESCRIPTION


application.describe = described  # type: ignore[attr-defined]


@dataclass
class Api:
    """The application, its database, and a token for each kind of asker."""

    app: FastAPI
    client: TestClient
    owner: Database
    tokens: dict[str, str] = field(default_factory=dict)
    team_ids: dict[str, int] = field(default_factory=dict)

    @property
    def services(self) -> Services:
        services: Services = self.app.state.services
        return services

    @property
    def database(self) -> Database:
        """The records as their owner sees them; on PostgreSQL the application has fewer rights."""
        return self.owner

    def headers(self, who: str | None) -> dict[str, str]:
        return {} if who is None else {"Authorization": f"Bearer {self.tokens[who]}"}

    def get(self, path: str, who: str | None = None, **more: Any) -> Any:
        return self.request("GET", path, who, **more)

    def post(self, path: str, who: str | None = None, **more: Any) -> Any:
        return self.request("POST", path, who, **more)

    def request(self, method: str, path: str, who: str | None = None, **more: Any) -> Any:
        """Send a request below /api/v1, or to a whole path such as /healthz."""
        whole = path if path.startswith(("/healthz", "/readyz", "/metrics")) else PREFIX + path
        headers = {**self.headers(who), **more.pop("headers", {})}
        return self.client.request(method, whole, headers=headers, **more)

    def submit(self, content: bytes | str, who: str | None = "alpha", **fields: Any) -> Any:
        """Upload; keywords replace form fields, None leaves one out."""
        data = content.encode() if isinstance(content, str) else content
        form = {"phase": "dev", "method": "Planner", **fields}
        return self.post(
            "/submissions",
            who,
            data={key: value for key, value in form.items() if value is not None},
            files={"file": ("planner.json", data)},
        )

    def phase(self, phase_id: str, **more: Any) -> None:
        with self.database.write() as session:
            add_phase(session, phase_id, **more)

    def claim(self, submission_id: str) -> Job:
        """Do what a worker does before it scores."""
        with self.database.write() as session:
            job = session.query(Job).filter_by(submission_id=submission_id).one()
            claim = claim_this(session, job.id, 120, 4)
        assert claim is not None
        return claim

    def reject(self, submission_id: str, report: CheckReport) -> None:
        """Do what a worker does when a file is wrong."""
        claim = self.claim(submission_id)
        with self.database.write() as session:
            jobs.finish_rejected(session, claim, report)

    def fail(self, submission_id: str, message: str = "The store is away.") -> None:
        """Do what a worker does when our own part is broken for good."""
        claim = self.claim(submission_id)
        with self.database.write() as session:
            jobs.finish_failed(session, claim, "store_broken", message, retry=False)

    def last_line(self) -> AuditLine:
        """The newest line of the audit log."""
        with self.database.read() as session:
            return session.scalars(select(AuditLine).order_by(AuditLine.id.desc()).limit(1)).one()

    def score(self, submission_id: str, hcc: float = 0.5) -> None:
        """Do what a worker does when it has scored."""
        claim = self.claim(submission_id)
        with self.database.write() as session:
            jobs.finish_scored(
                session,
                claim,
                sheet(hcc),
                exact_digest="sha256:exact",
                measurement_key="m",
                scorer_version="1",
            )

    def describe(self, report: CheckReport) -> None:
        """Do what a worker does when it has described the file that waits longest."""
        with self.database.write() as session:
            item = claim_oldest(session, Profile, 120, 4)
        assert item is not None
        with self.database.write() as session:
            assert finish_profile(session, item, report)

    def publish(self, *entries: BoardEntry, phase: str = "dev") -> BoardRow:
        """Do what a worker does when it has built a board."""
        with self.database.write() as session:
            want_board(session, phase, PROTOCOL.digest)
        board = make_board(
            *entries,
            phase=phase,
            protocol=ProtocolRef(version="1.0", digest=PROTOCOL.digest),
            published_at=datetime(2026, 11, 21, tzinfo=UTC),
            families=(FamilyHead(id="sudden_emergence", title="Sudden Emergence", n=3),),
        )
        with self.database.write() as session:
            claim = claim_board_of(session, phase, PROTOCOL.digest)
            assert claim is not None
            row = publish_board(session, claim, board)
        assert row is not None
        return row


@dataclass
class TeamBrowser:
    """A browser before the pages: keeps cookies, reads the token of a form, sends its origin."""

    api: Api
    base_url: str
    origin: str
    client: TestClient

    @classmethod
    def open(cls, api: Api, base_url: str, origin: str | None = None) -> "TeamBrowser":
        client = TestClient(
            api.app, base_url=base_url, follow_redirects=False, raise_server_exceptions=False
        )
        return cls(api, base_url, origin or base_url, client)

    def fresh(self) -> "TeamBrowser":
        return TeamBrowser.open(self.api, self.base_url, self.origin)

    def get(self, path: str, accept: str = "text/html") -> Any:
        return self.client.get(path, headers={"Accept": accept})

    def form_token(self, page: str) -> str:
        found = re.search(r'name="form_token" value="([0-9a-f]{64})"', self.get(page).text)
        assert found is not None, page
        return found[1]

    def form(self, page: str) -> dict[str, str]:
        return {"form_token": self.form_token(page)}

    def send(self, path: str, data: dict[str, Any], accept: str = "*/*", **more: Any) -> Any:
        headers = {"Accept": accept, "Origin": self.origin}
        return self.client.post(path, data=data, headers=headers, **more)

    def post(self, path: str, data: dict[str, Any], *, page: str, **more: Any) -> Any:
        """Send a form that stands on a page."""
        return self.send(path, {**self.form(page), **data}, **more)

    def sign_in(self, who: str, **more: str) -> Any:
        return self.sign_in_with(self.api.tokens[who], **more)

    def sign_in_with(self, token: str, accept: str = "*/*", **more: str) -> Any:
        return self.post("/sign-in", {"token": token, **more}, page="/sign-in", accept=accept)

    def submit(self, content: bytes | str, **fields: Any) -> Any:
        """Send the upload form."""
        data = content.encode() if isinstance(content, str) else content
        form = {"phase": "dev", "method": "Planner", **fields}
        given = {key: value for key, value in form.items() if value is not None}
        return self.post("/submit", given, page="/submit", files={"file": ("planner.json", data)})


def _populate(database: Database) -> Founded:
    with database.write() as session:
        made = found(session, ("alpha", "beta"))
        add_sample_split(session)
        add_phase(session, quota_per_day=5)
    return made


@pytest.fixture
def make_api(tmp_path: Path, snapshots: Snapshots) -> Iterator[Callable[..., Api]]:
    """Makes the application over a database address; keywords are settings."""
    with ExitStack() as stack:

        def make(url: str, **settings: Any) -> Api:
            given = {
                "broker_url": f"redis+socket://{tmp_path}/nobody.sock",
                "file_store_url": (tmp_path / "uploads").as_uri(),
                "receipt_key_file": tmp_path / "receipt-key.pem",
                "max_upload_bytes": MAX_UPLOAD_BYTES,
                "events_every_s": 0.01,
                "uploads_at_once": 64,
                "uploads_at_once_per_team": 32,
                **settings,
            }
            app = create_app(ServerSettings(database_url=as_role(url, Role.API), **given))
            owner = Database(url)
            client = TestClient(app, raise_server_exceptions=False, base_url="http://server.test")
            stack.callback(owner.dispose)
            stack.callback(app.state.services.close)
            made = snapshots.fill("two teams", url, tmp_path, lambda: _populate(owner))
            return Api(app, client, owner, made.tokens, made.team_ids)

        yield make


@pytest.fixture
def api(make_api: Callable[..., Api], sqlite_url: str) -> Api:
    """The application on SQLite."""
    return make_api(sqlite_url)


@pytest.fixture
def api_on_both(make_api: Callable[..., Api], database_url: str) -> Api:
    """The application on SQLite, then on PostgreSQL."""
    return make_api(database_url)


@pytest.fixture
def browse() -> Callable[..., TeamBrowser]:
    """Opens a browser before the pages of an application, in which `who` has signed in."""

    def opened(
        api: Api,
        base_url: str = "https://server.test",
        origin: str | None = None,
        *,
        who: str | None = None,
    ) -> TeamBrowser:
        browser = TeamBrowser.open(api, base_url, origin)
        if who is not None:
            assert browser.sign_in(who).status_code == 303
        return browser

    return opened


@pytest.fixture
def as_problem() -> Callable[[Any, int, str], dict[str, Any]]:
    """Checks that an answer is a problem of a status and code, and returns it."""

    def check(response: Any, status: int, code: str) -> dict[str, Any]:
        assert response.status_code == status, response.text
        assert response.headers["content-type"] == "application/problem+json"
        problem: dict[str, Any] = response.json()
        assert (problem["status"], problem["code"]) == (status, code)
        assert problem["type"] == f"/problems/{code}"
        assert problem["request_id"] == response.headers["x-request-id"]
        return problem

    return check


@pytest.fixture(autouse=True)
def logs() -> Iterator[list[Any]]:
    """What was logged; nothing of it is printed."""
    with structlog.testing.capture_logs() as captured:
        yield captured
