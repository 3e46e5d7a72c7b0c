"""Canaries in a withheld split: after good, bad and failing runs they are nowhere but in the split.

The canaries are a coordinate, as text and as bits, and the name of a scene. Searched are every
table, every command that the broker ever got, the worker's log and its terminal.
"""

import json
import os
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import text
from tests.support.floors import leave_open

from exceptiondrive_records.boards.boards import current_board
from exceptiondrive_records.db.base import Base
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.db.settings import RecordsSettings
from exceptiondrive_records.phases.phases import create_phase
from exceptiondrive_records.protocols.protocols import add_protocol
from exceptiondrive_records.submissions.file_store import FileStore
from exceptiondrive_records.submissions.submissions import accept
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.teams.teams import create_team
from exceptiondrive_records.work.dispatch import Dispatcher, wake_lanes
from exceptiondrive_schemas.api.phase_settings import NewPhase
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.jobs import JobName
from exceptiondrive_schemas.protocol import packaged_protocol_toml

CANARY_M = 23.719413
CANARY_SCENE = "scene-canary-8c1f"
REGION = [[CANARY_M, -1.0], [26.0, -1.0], [26.0, 1.0], [CANARY_M, 1.0]]
NEEDLES = {
    "coordinate": b"23.7194",
    "its bits": struct.pack("<d", CANARY_M),
    "its bits, turned": struct.pack(">d", CANARY_M),
    "scene": CANARY_SCENE.encode(),
}
CLI = "from exceptiondrive_worker.operator_cli import main; main()"


@pytest.fixture(scope="session")
def world_settings() -> RecordsSettings:
    """Settings of whoever wakes workers: the defaults."""
    return RecordsSettings()


def split_document(**changes: Any) -> dict[str, Any]:
    sample = {"sample_id": "s1", "scene_id": CANARY_SCENE, "task": "LB1", "region": REGION}
    return {
        "schema": "exceptiondrive.split/1",
        "name": "withheld",
        "title": "Withheld",
        "samples": [{**sample, **changes}, {**sample, "sample_id": "s2", "task": "SE1"}],
    }


def upload(edited_x_m: float, **changes: Any) -> bytes:
    way = [[edited_x_m * step, 0.0] for step in range(1, 7)]
    predictions = [{"sample_id": key, "source": way, "edited": way} for key in ("s1", "s2")]
    document = {
        "schema": "exceptiondrive.planning/1",
        "split": "withheld",
        "predictions": predictions,
    }
    return json.dumps(document | changes).encode()


class Site:
    """One machine: records, uploads, splits, and the environment of a worker."""

    def __init__(self, folder: Path, database_url: str, broker_url: str) -> None:
        self.folder = folder
        self.split_path = folder / "splits" / "withheld" / "split.json"
        leave_open(self.split_path.parent)
        self.log_path = folder / "worker.log"
        self.database = Database(database_url)
        self.files = FileStore(f"file://{folder}/uploads")
        self.broker_url = broker_url
        inherited = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
        self.environment = inherited | {
            "PYTHONPYCACHEPREFIX": f"{tempfile.gettempdir()}/exceptiondrive-tests-pycache",
            "EXCEPTIONDRIVE_DATABASE_URL": database_url,
            "EXCEPTIONDRIVE_BROKER_URL": broker_url,
            "EXCEPTIONDRIVE_FILE_STORE_URL": f"file://{folder}/uploads",
            "EXCEPTIONDRIVE_SPLITS_DIR": str(folder / "splits"),
            "EXCEPTIONDRIVE_PRIVATE_DIR": str(folder / "private"),
            "EXCEPTIONDRIVE_MAX_ATTEMPTS": "1",
        }

    def operate(self, *arguments: str) -> str:
        """Run one operator command; return all that it printed."""
        done = subprocess.run(
            [sys.executable, "-c", CLI, *arguments],
            env=self.environment,
            capture_output=True,
            text=True,
            check=False,
        )
        return done.stdout + done.stderr

    def submit(self, data: bytes, method: str, dispatcher: Dispatcher, settings: Any) -> str:
        digest, size = self.files.put_stream([data], limit_bytes=2**20)
        with self.database.write() as session:
            accepted = accept(
                session,
                team_id=1,
                phase_id="dev",
                method=method,
                file_digest=digest,
                size_bytes=size,
            )
        assert accepted.job_id is not None
        assert wake_lanes(self.database, dispatcher, settings)
        return accepted.submission.id

    def status(self, submission_id: str) -> SubmissionStatus:
        with self.database.read() as session:
            return session.get_one(Submission, submission_id).status

    def everything_recorded(self) -> bytes:
        """Every value of every table, as text, and the files that SQLite keeps."""
        with self.database.engine.connect() as connection:
            rows = [
                repr(tuple(row))
                for table in Base.metadata.sorted_tables
                for row in connection.execute(text(f'SELECT * FROM "{table.name}"'))
            ]
        files = [path.read_bytes() for path in sorted(self.folder.glob("records.sqlite3*"))]
        return b"".join([*(row.encode() for row in rows), *files])


@pytest.fixture
def site(tmp_path: Path, sqlite_url: str, broker_url: str) -> Iterator[Site]:
    made = Site(tmp_path, sqlite_url, broker_url)
    made.split_path.write_text(json.dumps(split_document()))
    yield made
    made.database.dispose()


@pytest.fixture
def worker(site: Site) -> Iterator[subprocess.Popen[bytes]]:
    with site.log_path.open("wb") as log:
        process = subprocess.Popen(
            [sys.executable, "-c", CLI, "run", "--concurrency", "1"],
            env=site.environment,
            stdout=log,
            stderr=log,
            start_new_session=True,
        )
    yield process
    process.terminate()
    process.wait(timeout=30)


def wait_for(question: Any) -> None:
    deadline = time.monotonic() + 60
    while not question():
        assert time.monotonic() < deadline, "waited for a minute in vain"
        time.sleep(0.01)


class Eavesdropper:
    """Takes down every byte that the broker is sent, in a thread."""

    def __init__(self, broker_url: str) -> None:
        self.heard = b""
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.connect(broker_url.removeprefix("redis+socket://"))
        self._socket.sendall(b"MONITOR\r\n")
        self._thread = threading.Thread(target=self._listen)
        self._thread.start()

    def _listen(self) -> None:
        while data := self._socket.recv(65536):
            self.heard += data

    def stop(self) -> bytes:
        """Stop listening; return what was heard."""
        self._socket.shutdown(socket.SHUT_RDWR)
        self._thread.join()
        self._socket.close()
        return self.heard


def seed(site: Site) -> str:
    printed = site.operate("register-splits")
    with site.database.write() as session:
        add_protocol(session, packaged_protocol_toml(), "test")
        create_phase(
            session,
            NewPhase(
                id="dev",
                challenge=PLANNING.id,
                title="Dev",
                split="withheld",
                protocol="1.0",
                quota_per_day=50,
            ),
            actor="test",
        )
        create_team(session, "alpha", "Alpha", actor="test")
    return printed


@pytest.mark.row("I26")
def test_no_canary_leaves_the_worker(
    site: Site, worker: subprocess.Popen[bytes], world_settings: Any
) -> None:
    eavesdropper = Eavesdropper(site.broker_url)
    printed = seed(site)
    dispatcher = Dispatcher(site.broker_url)
    good = site.submit(upload(1.0), "good", dispatcher, world_settings)
    hit = site.submit(upload(4.5), "hit", dispatcher, world_settings)
    bad = site.submit(upload(1.0, split="other"), "bad", dispatcher, world_settings)
    wait_for(lambda: all(site.status(one).is_terminal for one in (good, hit, bad)))

    def board_has_both() -> bool:
        with site.database.read() as session:
            row = current_board(session, "dev")
            return row is not None and good in row.body and hit in row.body

    wait_for(board_has_both)
    # a split that is refused, and one that cannot be read: operators are told sample ids alone
    crossed = [REGION[0], REGION[2], REGION[1], REGION[3]]
    site.split_path.write_text(json.dumps(split_document(region=crossed)))
    refused = site.operate("check-split", str(site.split_path))
    site.split_path.write_text(json.dumps(split_document(region=[[CANARY_M, "x"]] * 4)))
    unreadable = site.operate("check-split", str(site.split_path))
    dispatcher.close()
    heard = eavesdropper.stop()

    assert site.status(good) is SubmissionStatus.SCORED
    assert site.status(hit) is SubmissionStatus.SCORED
    assert site.status(bad) is SubmissionStatus.REJECTED
    assert "s1" in refused
    assert "s1" in unreadable
    assert JobName.WAKE.value.encode() in heard
    places = {
        "records": site.everything_recorded(),
        "broker": heard,
        "worker's log": site.log_path.read_bytes(),
        "operator's terminal": (printed + refused + unreadable).encode(),
    }
    assert all(places.values())
    found = [
        (place, what)
        for place, content in places.items()
        for what, needle in NEEDLES.items()
        if needle in content
    ]
    assert found == []


def test_the_search_would_find_a_canary(site: Site) -> None:
    with site.database.write() as session:
        create_team(session, "leak", f"Region at {CANARY_M}", actor="test")
    recorded = site.everything_recorded()
    assert NEEDLES["coordinate"] in recorded
    assert NEEDLES["scene"] not in recorded
