"""Fixtures of the client's tests: small files, a home of its own, and a server with set answers.

The set answers are for what a healthy server does not do on demand (503, Retry-After, rubbish);
all else is tested against the real application in test_with_server.py.
"""

import json
import os
import threading
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from tests.support.snapshots import Snapshots

from tests.client.servers import SPLIT, STRAIGHT, CannedServer, Running, fill_records, work_until

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
    tokens = snapshots.fill("client", sqlite_url, tmp_path, lambda: fill_records(context))
    application = create_app(ServerSettings(**places, receipt_key_file=tmp_path / "key.pem"))
    # CliRunner would take the server's lines for the CLI's
    with served(application) as url, structlog.testing.capture_logs():
        yield Running(url, *tokens, context)
    context.close()


@pytest.fixture
def working(running: Running) -> Iterator[Running]:
    """The same, with the worker's functions doing what is queued."""
    stop = threading.Event()
    thread = threading.Thread(target=work_until, args=(running.context, stop), daemon=True)
    thread.start()
    yield running
    stop.set()
    thread.join()


@pytest.fixture
def pipe(tmp_path: Path) -> tuple[Path, Callable[[], bytes]]:
    """A named pipe that somebody reads, and what tells all that came through, and takes it away."""
    if os.name != "posix":
        pytest.skip("needs named pipes")
    path = tmp_path / "planner.json"
    os.mkfifo(path)
    read: list[bytes] = []
    reader = threading.Thread(target=lambda: read.append(path.read_bytes()), daemon=True)
    reader.start()

    def all_read() -> bytes:
        reader.join()
        assert path.is_fifo()
        path.unlink()  # or who looks through the files of tests would wait on it
        return read[0]

    return path, all_read
