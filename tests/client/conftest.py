"""Fixtures of the client's tests: small files, a home of its own, and a server with set answers.

The set answers are for what a healthy server does not do on demand (503, Retry-After, rubbish);
all else is tested against the real application in test_with_server.py.
"""

import json
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from exceptiondrive import Client

if TYPE_CHECKING:
    from tests.support.snapshots import Snapshots

    from exceptiondrive_worker.context import WorkerContext

IS_ALONE = find_spec("exceptiondrive_server") is None
"""The client by itself, as on Python 3.10: see tests/on_every_python.py."""
collect_ignore = (
    [
        *("test_newer_server.py", "test_organizer_commands.py", "test_phase_commands.py"),
        *("test_third_challenge.py", "test_wheel.py", "test_action.py"),
    ]
    if IS_ALONE
    else []
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip what needs the server, where there is none."""
    for item in items if IS_ALONE else ():
        if {"running", "working", "sqlite_url"} & set(getattr(item, "fixturenames", ())):
            item.add_marker(pytest.mark.skip(reason="needs the server"))


STRAIGHT = [[4.0 * step, 0.0] for step in range(1, 7)]
SPLIT = {
    "schema": "exceptiondrive.split/1",
    "name": "tiny",
    "title": "Tiny",
    "samples": [
        {
            "sample_id": f"s{number}",
            "scene_id": f"scene-{number // 2}",
            "task": ("SE1", "LB1", "SR1", "IC1")[number],
            "region": [[20.0, -1.0], [22.0, -1.0], [22.0, 1.0], [20.0, 1.0]],
        }
        for number in range(4)
    ],
}

Answer = tuple[int, dict[str, str], bytes]


@pytest.fixture(autouse=True)
def home(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A home without tokens, and an environment without settings of this client."""
    home = tmp_path_factory.mktemp("home")
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(home / "config"))
    for name in ("SERVER", "TOKEN", "PHASE"):
        monkeypatch.delenv(f"EXCEPTIONDRIVE_{name}", raising=False)
    for name in ("NO_COLOR", "FORCE_COLOR"):
        monkeypatch.delenv(name, raising=False)
    return home


@pytest.fixture
def planning_file(tmp_path: Path) -> Callable[..., Path]:
    """Writes a valid file for the tiny split; keyword arguments replace parts of it."""

    def write(name: str = "planner.json", **changes: Any) -> Path:
        predictions = [
            {"sample_id": f"s{number}", "source": STRAIGHT, "edited": STRAIGHT}
            for number in range(4)
        ]
        document = {"schema": "exceptiondrive.planning/1", "split": "tiny"}
        path = tmp_path / name
        path.write_text(json.dumps({**document, "predictions": predictions, **changes}))
        return path

    return write


@pytest.fixture
def split_file(tmp_path: Path) -> Path:
    """The tiny split with its regions."""
    path = tmp_path / "tiny.split.json"
    path.write_text(json.dumps(SPLIT))
    return path


@dataclass
class CannedServer:
    """A real HTTP server on the loopback that gives set answers, the last one for ever."""

    url: str = ""
    answers: dict[str, list[Answer]] = field(default_factory=dict)
    requests: list[tuple[str, str, bytes]] = field(default_factory=list)
    headers: list[dict[str, str]] = field(default_factory=list)

    def answer(
        self, path: str, status: int, document: Any, headers: dict[str, str] | None = None
    ) -> None:
        """Add an answer for `METHOD /path`, to be given once the earlier ones are used."""
        body = document if isinstance(document, bytes) else json.dumps(document).encode()
        self.answers.setdefault(path, []).append((status, headers or {}, body))

    def problem(self, path: str, status: int, code: str, **more: Any) -> None:
        """Add an RFC 9457 problem."""
        document = {
            "type": f"/problems/{code}",
            "title": code,
            "status": status,
            "code": code,
            "detail": more.pop("detail", f"The server says {code}."),
        }
        self.answer(path, status, {**document, **more})

    def take(self, path: str) -> Answer:
        """Return the next answer for a path."""
        waiting = self.answers.get(path) or [(404, {}, b"no such canned answer")]
        return waiting.pop(0) if len(waiting) > 1 else waiting[0]


@pytest.fixture
def canned_server() -> Iterator[CannedServer]:
    """Start a server with set answers."""
    canned = CannedServer()

    class Handler(BaseHTTPRequestHandler):
        def _serve(self) -> None:
            body = self.rfile.read(int(self.headers.get("content-length") or 0))
            path = self.path.split("?")[0].removeprefix("/api/v1")
            canned.requests.append((self.command, self.path, body))
            canned.headers.append(dict(self.headers))
            status, headers, content = canned.take(f"{self.command} {path}")
            self.send_response(status)
            for name, value in headers.items():
                self.send_header(name, value)
            self.send_header("content-length", str(len(content)))
            self.end_headers()
            self.wfile.write(content)

        do_GET = do_POST = _serve  # noqa: N815

        def log_message(self, *_: object) -> None:
            """Say nothing."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    canned.url = f"http://127.0.0.1:{server.server_port}"
    thread = threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True)
    thread.start()
    yield canned
    server.shutdown()
    server.server_close()
    thread.join()


# The real application, in a thread on the loopback over a SQLite file. The worker's own functions
# run in another thread, in place of Celery, which tests/end_to_end has.


@dataclass
class Running:
    """A server with a phase of each challenge on the tiny split, a team and an organizer."""

    url: str
    token: str
    organizer_token: str
    context: "WorkerContext"

    def client(self) -> Client:
        return Client(self.url, self.token)


@pytest.fixture
def running(
    tmp_path: Path, sqlite_url: str, broker_url: str, split_file: Path, snapshots: "Snapshots"
) -> Iterator[Running]:
    """Start the application, without a worker."""
    import structlog
    from tests.support.serving import served

    from exceptiondrive_server.app import create_app
    from exceptiondrive_server.web.settings import ServerSettings
    from exceptiondrive_worker.context import open_context
    from exceptiondrive_worker.settings import WorkerSettings

    places: dict[str, Any] = {
        "database_url": sqlite_url,
        "broker_url": broker_url,
        "file_store_url": (tmp_path / "uploads").as_uri(),
    }
    folder = tmp_path / "splits" / "tiny"
    folder.mkdir(parents=True)
    (folder / "split.json").write_bytes(split_file.read_bytes())
    worker = WorkerSettings(**places, splits_dir=folder.parent, private_dir=tmp_path / "private")
    context = open_context(worker)
    tokens = snapshots.fill("client", sqlite_url, tmp_path, lambda: _fill_records(context))
    application = create_app(ServerSettings(**places, receipt_key_file=tmp_path / "key.pem"))
    # CliRunner would take the server's lines for the CLI's
    with served(application) as url, structlog.testing.capture_logs():
        yield Running(url, *tokens, context)
    context.close()


def _fill_records(context: "WorkerContext") -> tuple[str, str]:
    """Make protocol, split, two phases, a team and its token, an organizer and theirs."""
    from tests.support.records import add_phase, found

    from exceptiondrive_records.accounts.tokens import PARTICIPANT_SCOPES
    from exceptiondrive_schemas.protocol import packaged_protocol
    from exceptiondrive_worker.splits.admin import publish_split_file, register_all_splits

    protocol = packaged_protocol()
    with context.database.write() as session:
        tokens = found(session, scopes=PARTICIPANT_SCOPES).tokens
    register_all_splits(context.database, context.splits, protocol)
    publish_split_file(context.database, context.files, context.splits, "tiny", protocol)
    with context.database.write() as session:
        for phase, challenge in (("dev", "planning"), ("words", "strategy")):
            usual = {"title": "Development", "split": "tiny", "quota_per_day": 2}
            add_phase(session, phase, challenge=challenge, **usual)
    return tokens["alpha"], tokens["organizer"]


@pytest.fixture
def working(running: Running) -> Iterator[Running]:
    """The same, with the worker's functions doing what is queued."""
    stop = threading.Event()
    thread = threading.Thread(target=_work, args=(running.context, stop), daemon=True)
    thread.start()
    yield running
    stop.set()
    thread.join()


def _work(context: "WorkerContext", stop: threading.Event) -> None:
    from tests.support.worker import build_wanted_boards, due_jobs, score_submission

    from exceptiondrive_worker.profile_run import describe_next

    while not stop.wait(0.02):
        for job_id in due_jobs(context.database):
            score_submission(context, job_id)
        build_wanted_boards(context)
        describe_next(context)
