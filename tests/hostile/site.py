"""The whole path of a hostile upload: real API, records and file store, worker in this process."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import structlog
from starlette.testclient import TestClient
from tests.canary.values import CANARY_M
from tests.support.documents import region_ahead, split_document
from tests.support.records import add_phase, found
from tests.support.worker import add_split, build_board_of, score_submission, worker_settings

from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.work.tables import Job
from exceptiondrive_schemas.protocol import packaged_protocol
from exceptiondrive_server.app import create_app
from exceptiondrive_server.web.settings import ServerSettings
from exceptiondrive_worker.context import WorkerContext, open_context

PROTOCOL = packaged_protocol()
N_SAMPLES = 2


@dataclass
class Site:
    """A server, and the context of its worker."""

    client: TestClient
    context: WorkerContext
    token: str

    def post(self, data: bytes, method: str = "Probe", **form: str) -> Any:
        return self.client.post(
            "/api/v1/submissions",
            headers={"Authorization": f"Bearer {self.token}"},
            data={"phase": "dev", "method": method, **form},
            files={"file": ("probe.json", data)},
        )

    def score(self, data: bytes, **form: str) -> dict[str, Any]:
        """Upload, let the worker score it, and return what the team is shown."""
        response = self.post(data, **form)
        assert response.status_code in (200, 202), response.text
        submission_id = response.json()["id"]
        with self.context.database.read() as session:
            job_id = session.query(Job).filter_by(submission_id=submission_id).one().id
        score_submission(self.context, job_id)
        return self.shown(submission_id)

    def shown(self, submission_id: str) -> dict[str, Any]:
        headers = {"Authorization": f"Bearer {self.token}"}
        response = self.client.get(f"/api/v1/submissions/{submission_id}", headers=headers)
        assert len(response.content) < 32 * 1024
        shown: dict[str, Any] = response.json()
        return shown

    def publish(self) -> None:
        build_board_of(self.context, "dev", PROTOCOL.digest)

    @property
    def n_submissions(self) -> int:
        with self.context.database.read() as session:
            return session.query(Submission).count()


@contextmanager
def open_site(folder: Path, migrated_sqlite: Path) -> Iterator[Site]:
    """Open a site in a folder, with one team and one phase."""
    shutil.copy(migrated_sqlite, folder / "records.sqlite3")
    hazard = {"task": "LB1", "region": region_ahead(40.0, CANARY_M)}
    made = split_document({f"s{i}": {"scene_id": f"scene-{i}", **hazard} for i in range(N_SAMPLES)})
    places: dict[str, Any] = {
        "database_url": f"sqlite:///{folder}/records.sqlite3",
        "file_store_url": (folder / "uploads").as_uri(),
    }
    context = open_context(worker_settings(folder, **places))
    with context.database.write() as session:
        token = found(session, ("mallory",)).tokens["mallory"]
    add_split(context.database, folder / "splits", made)
    with context.database.write() as session:
        add_phase(session, split="tiny", quota_per_day=10_000, rejected_per_day=10_000)
    settings = ServerSettings(
        **places,
        broker_url=f"redis+socket://{folder}/nobody.sock",
        receipt_key_file=folder / "receipt-key.pem",
    )
    with (
        structlog.testing.capture_logs(),
        TestClient(create_app(settings), raise_server_exceptions=False) as client,
    ):
        yield Site(client, context, token)
    context.close()
