"""One pass through records, worker, board and API: they publish what the audit's oracle says."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from starlette.testclient import TestClient
from tests.support.worker import build_board_of, score_submission

from exceptiondrive_records.accounts.tokens import issue_token
from exceptiondrive_records.phases.phases import create_phase
from exceptiondrive_records.protocols.protocols import add_protocol
from exceptiondrive_records.teams.teams import create_team
from exceptiondrive_records.work.tables import Job
from exceptiondrive_schemas.api.phase_settings import NewPhase
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.protocol import ProtocolDocument, packaged_protocol_toml
from exceptiondrive_schemas.score_sheet import ScoreSheet
from exceptiondrive_server.app import create_app
from exceptiondrive_server.web.settings import ServerSettings
from exceptiondrive_worker.context import WorkerContext, open_context
from exceptiondrive_worker.settings import WorkerSettings
from exceptiondrive_worker.splits.admin import register_all_splits

if TYPE_CHECKING:
    from tests.leak.oracle import Oracle

SPLITS = Path(__file__).parents[2] / "hidden_splits"
API = "/api/v1"


class Participant:
    """Uploads by HTTP and reads what is public; workers score in this process."""

    def __init__(self, client: TestClient, token: str, context: WorkerContext, digest: str) -> None:
        self.client, self.context, self.digest = client, context, digest
        self.headers = {"Authorization": f"Bearer {token}"}

    def publish(self, split: str, ids: tuple[str, ...], edited: Any) -> str:
        still = [[0.0, 0.0]] * 6
        answers = [
            {
                "sample_id": key,
                "source": still,
                "edited": None if np.isnan(way).any() else way.tolist(),
            }
            for key, way in zip(ids, edited, strict=True)
        ]
        document = {"schema": "exceptiondrive.planning/1", "split": split, "predictions": answers}
        response = self.client.post(
            f"{API}/submissions",
            headers=self.headers,
            data={"phase": "sample", "method": "Probe"},
            files={"file": ("probe.json", json.dumps(document).encode())},
        )
        assert response.status_code == 202, response.text
        submission_id: str = response.json()["id"]
        with self.context.database.read() as session:
            job_id = session.query(Job).filter_by(submission_id=submission_id).one().id
        score_submission(self.context, job_id)
        build_board_of(self.context, "sample", self.digest)
        return submission_id

    def get(self, path: str) -> str:
        response = self.client.get(path, headers=self.headers)
        assert response.status_code == 200, (path, response.text[:300])
        return response.text


@pytest.fixture
def participant(
    tmp_path: Path, sqlite_url: str, protocol: ProtocolDocument
) -> Iterator[Participant]:
    places: dict[str, Any] = {
        "database_url": sqlite_url,
        "broker_url": f"redis+socket://{tmp_path}/nobody.sock",
        "file_store_url": (tmp_path / "uploads").as_uri(),
    }
    worker: dict[str, Any] = {
        "splits_dir": SPLITS,
        "private_dir": tmp_path / "private",
    }
    context = open_context(WorkerSettings(**places, **worker))
    with context.database.write() as session:
        add_protocol(session, packaged_protocol_toml(), "test")
    register_all_splits(context.database, context.splits, protocol)
    with context.database.write() as session:
        create_phase(
            session,
            NewPhase(
                id="sample",
                challenge=PLANNING.id,
                title="Sample",
                split="sample",
                protocol="1.0",
                quota_per_day=20,
            ),
            actor="test",
        )
        team = create_team(session, "mallory", "Mallory", actor="test")
        token, _ = issue_token(session, team.id, "laptop", actor="test")
    settings = ServerSettings(
        **places,
        receipt_key_file=tmp_path / "receipt-key.pem",
    )
    with TestClient(create_app(settings)) as client:
        yield Participant(client, token, context, protocol.digest)
    context.close()


def numbers(text: str) -> list[str]:
    """Every number with decimals, but for those in times."""
    return re.findall(r"-?\d+\.\d+(?:e-?\d+)?", re.sub(r"\d\dT\d\d:\d\d:[\d.]+", "", text))


def exact_numbers(value: Any) -> set[str]:
    """First digits of every exact mean that rounding must cut."""
    if isinstance(value, dict):
        return {found for item in value.values() for found in exact_numbers(item)}
    is_cut = isinstance(value, float) and round(value, 4) != value
    return {f"{value:.7f}"[:8]} if is_cut else set()


def test_the_api_publishes_what_the_oracle_says_and_not_a_digit_more(
    participant: Participant, oracle: "Oracle"
) -> None:
    ids, published = oracle.split.manifest.sample_ids, []
    counted = oracle.split.rows
    assert counted is not None, "the controls do not count"
    edited = np.zeros((len(ids), 6, 2))
    first = edited.copy()
    edited[counted[0]] = np.nan  # one sample less than `first`: the differencing attack
    for of_all in (first, edited):
        submission_id = participant.publish("sample", ids, of_all)
        ways = of_all[counted]
        sheet = json.loads(participant.get(f"{API}/submissions/{submission_id}"))["sheet"]
        said = oracle.ask(ways)
        assert sheet["micro"].pop("over_caution") is None, "a source that stands has no progress"
        published.append(ScoreSheet.model_validate_json(json.dumps(sheet)))
        for name in ("micro", "macro_family", "families", "tasks", "coverage"):
            assert getattr(published[-1], name) == getattr(said, name)
        exact = oracle.exact(ways)
        places = {
            path: participant.get(path)
            for path in (
                f"{API}/submissions/{submission_id}",
                f"{API}/submissions/{submission_id}/receipt",
                f"{API}/submissions",
                f"{API}/leaderboard?phase=sample",
                f"{API}/leaderboard?phase=sample&sort=-hpr",
                f"{API}/leaderboard.csv?phase=sample",
                f"{API}/entries/{submission_id}",
                f"{API}/entries/{submission_id}/receipt",
                f"/entries/{submission_id}",
                "/?phase=sample",
            )
        }
        hidden = exact_numbers(
            {key: getattr(exact, key) for key in ("micro", "macro_family")}
            | {key: row.metrics for key, row in {**exact.families, **exact.tasks}.items()}
        )
        assert len(hidden) > 20
        for path, text in places.items():
            assert [digits for digits in hidden if digits in text] == [], path
            if path.startswith(API):
                longest = max(len(number.split(".")[1]) for number in numbers(text))
                assert longest <= 4, path
    lost = published[0].micro["ur"], published[1].micro["ur"]
    assert lost[1] == pytest.approx((lost[0] or 0) + 1 / 420, abs=1e-4)


def test_nothing_per_sample_is_published(participant: Participant, oracle: "Oracle") -> None:
    ids = oracle.split.manifest.sample_ids
    submission_id = participant.publish("sample", ids, np.zeros((len(ids), 6, 2)))
    scenes = re.compile(r"scene[-_]\d+")
    for path in (
        f"{API}/submissions/{submission_id}",
        f"{API}/leaderboard?phase=sample",
        f"{API}/entries/{submission_id}",
        f"{API}/leaderboard.csv?phase=sample",
    ):
        text = participant.get(path)
        assert [key for key in ids if key in text] == [], path
        assert not scenes.search(text), path
