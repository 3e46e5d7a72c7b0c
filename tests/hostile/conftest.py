"""The whole path of a hostile upload: real API, records and file store, worker in this process."""

import json
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import structlog
from starlette.testclient import TestClient
from tests.canary.values import CANARY_M
from tests.support.worker import build_board_of, score_submission

from exceptiondrive_records.accounts.tokens import issue_token
from exceptiondrive_records.phases.phases import create_phase
from exceptiondrive_records.protocols.protocols import add_protocol
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.teams.teams import create_team
from exceptiondrive_records.work.tables import Job
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.phase_settings import NewPhase
from exceptiondrive_schemas.protocol import packaged_protocol, packaged_protocol_toml
from exceptiondrive_server.app import create_app
from exceptiondrive_server.web.settings import ServerSettings
from exceptiondrive_worker.context import WorkerContext, open_context
from exceptiondrive_worker.settings import WorkerSettings
from exceptiondrive_worker.splits_admin import register_all_splits

PROTOCOL = packaged_protocol()
REGION = [[40.0, -1.0], [CANARY_M, -1.0], [CANARY_M, 1.0], [40.0, 1.0]]
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


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory, migrated_sqlite: Path) -> Iterator[Site]:
    folder = tmp_path_factory.mktemp("hostile")
    shutil.copy(migrated_sqlite, folder / "records.sqlite3")
    split = folder / "splits" / "tiny" / "split.json"
    split.parent.mkdir(parents=True)
    samples = [
        {"sample_id": f"s{i}", "scene_id": f"scene-{i}", "task": "LB1", "region": REGION}
        for i in range(N_SAMPLES)
    ]
    head = {"schema": "exceptiondrive.split/1", "name": "tiny", "title": "Tiny"}
    split.write_text(json.dumps({**head, "samples": samples}))
    places: dict[str, Any] = {
        "database_url": f"sqlite:///{folder}/records.sqlite3",
        "file_store_url": (folder / "uploads").as_uri(),
    }
    worker: dict[str, Any] = {"splits_dir": split.parents[1], "private_dir": folder / "private"}
    context = open_context(WorkerSettings(**places, **worker, broker_url="memory://"))
    with context.database.write() as session:
        add_protocol(session, packaged_protocol_toml(), "test")
    register_all_splits(context.database, context.splits, PROTOCOL)
    limits: dict[str, Any] = {"quota_per_day": 10_000, "rejected_per_day": 10_000}
    names: dict[str, Any] = {"title": "Dev", "split": "tiny", "protocol": "1.0"}
    with context.database.write() as session:
        create_phase(
            session,
            NewPhase(id="dev", challenge=PLANNING.id, **names, **limits),
            actor="test",
        )
        team = create_team(session, "mallory", "Mallory", actor="test")
        token, _ = issue_token(session, team.id, "laptop", actor="test")
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
