"""Worker and server over one database, one file store and one split with parts; nothing mocked.

Jobs run in the test's own process, as a worker runs them. Time is moved by moving the dates of the
phase: the database's clock is real.
"""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from starlette.testclient import TestClient
from tests.phases.life import SAMPLES, TEAMS, Beginning, Life, split_of
from tests.support.records import found
from tests.support.snapshots import Snapshots
from tests.support.worker import (
    worker_settings,
)

from exceptiondrive_schemas.split import Split
from exceptiondrive_server.app import create_app
from exceptiondrive_server.web.settings import ServerSettings
from exceptiondrive_worker.context import open_context


@pytest.fixture
def beginning() -> Beginning:
    """What has happened before each test of a file; a file may say so, and it is made once a process."""
    return "three teams", lambda life: None


@pytest.fixture
def life(
    database_url: str, tmp_path: Path, snapshots: Snapshots, beginning: Beginning
) -> Iterator[Life]:
    """Three teams, an organizer, a split with parts; SQLite, then PostgreSQL."""
    common: dict[str, Any] = {
        "database_url": database_url,
        "broker_url": f"redis+socket://{tmp_path}/nobody.sock",
        "file_store_url": (tmp_path / "uploads").as_uri(),
    }
    # `work` does what it can until nothing is left, and waits for it
    worker = worker_settings(tmp_path, retry_backoff_s=0.01, **common)
    server = ServerSettings(receipt_key_file=tmp_path / "key.pem", **common)
    app = create_app(server)
    client = TestClient(app, base_url="https://server.test", follow_redirects=False)
    made = Life(worker, open_context(worker), server, client)

    name, go_on = beginning

    def begin() -> tuple[dict[str, str], Any]:
        with made.database.write() as session:
            made.tokens = found(session, TEAMS).tokens
        made.add_split(split_of(SAMPLES, "parted"))
        made.add_split(split_of({k: (t, m, None) for k, (t, m, _) in SAMPLES.items()}, "plain"))
        return made.tokens, go_on(made)

    made.tokens, made.begun = snapshots.fill(name, database_url, tmp_path, begin)
    yield made
    made.context.close()
    app.state.services.close()


@pytest.fixture
def make_split() -> Callable[..., Split]:
    return split_of
