"""A real server: too many uploads at once, a stop in the middle of one, a schema newer than it."""

import json
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import httpx
import pytest
from sqlalchemy import select, text
from tests.chaos.clients import planning_file
from tests.chaos.topology import PHASE, Topology
from tests.operating.held_upload import HeldUpload

from exceptiondrive import Client
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_schemas.api.submission import SubmissionStatus

pytestmark = [pytest.mark.slow]
HOLDERS = ("alpha", "gamma")
"""Of a place each: of as few places as here a team has one at most."""


@pytest.fixture(scope="module")
def topology() -> Iterator[Topology]:
    settings = {"EXCEPTIONDRIVE_UPLOADS_AT_ONCE": str(len(HOLDERS))}
    started = Topology(settings=settings, is_forked=True)
    try:
        yield started
    finally:
        started.close()


@pytest.fixture(scope="module")
def make_file(topology: Topology) -> Callable[[float], bytes]:
    return lambda speed_mps: planning_file(topology.sample_ids, speed_mps)


def post(topology: Topology, data: bytes, method: str) -> httpx.Response:
    return httpx.post(
        f"{topology.url}/api/v1/submissions",
        data={"phase": PHASE, "method": method},
        files={"file": ("f.json", data)},
        headers={"Authorization": f"Bearer {topology.tokens['beta']}"},
        timeout=60,
    )


def log_lines(topology: Topology) -> list[str]:
    return (topology.folder / "server.log").read_text().splitlines()


def test_the_log_of_the_reconciler_is_json_lines(topology: Topology) -> None:
    logs = [topology.folder / f"reconciler-{number}.log" for number in (1, 2)]

    def lines() -> list[str]:
        return [line for log in logs for line in log.read_text().splitlines()]

    topology.wait_until(lambda: bool(lines()), "one to log", 60)
    assert all({"event", "level", "timestamp"} <= set(json.loads(line)) for line in lines())


def wait_for_scores(topology: Topology, submission_ids: list[str]) -> None:
    def statuses() -> set[SubmissionStatus]:
        with topology.database.read() as session:
            query = select(Submission.status).where(Submission.id.in_(submission_ids))
            return set(session.scalars(query))

    topology.wait_until(lambda: statuses() == {SubmissionStatus.SCORED}, "all to be scored", 120)


def test_uploads_beyond_the_limit_are_sent_away_and_nothing_accepted_is_lost(
    topology: Topology, make_file: Callable[[float], bytes], tmp_path: Path
) -> None:
    held = [HeldUpload(topology, make_file(1), f"held by {team}", team) for team in HOLDERS]
    probes: list[httpx.Response] = []

    def is_sent_away() -> bool:
        probes.append(post(topology, make_file(2), "probe"))
        return probes[-1].is_error

    topology.wait_until(is_sent_away, "an upload to be sent away")
    assert probes[-1].status_code == 503
    assert int(probes[-1].headers["Retry-After"]) > 0
    assert probes[-1].json()["code"] == "store_unavailable"
    assert httpx.get(f"{topology.url}/?phase={PHASE}").status_code == 200, "pages are served"
    ids = []

    def submit(number: int) -> str:
        file = tmp_path / f"{number}.json"
        file.write_bytes(make_file(3 + number / 10))
        team = sorted(topology.tokens)[number % 3]
        with Client(topology.url, topology.tokens[team]) as client:
            return client.submit(file, phase=PHASE, method=f"c{number}").id

    with ThreadPoolExecutor(6) as pool:
        patient = [pool.submit(submit, number) for number in range(6)]
        answers = [upload.finish() for upload in held]
        ids += [task.result() for task in patient]
    assert [status for status, _ in answers] == [202, 202]
    wait_for_scores(topology, ids + [view["id"] for _, view in answers])
    assert len(set(ids)) == 6
    logged = [json.loads(line) for line in log_lines(topology) if '"upload accepted"' in line]
    assert set(ids) <= {line["submission"] for line in logged}
    assert all(len(line["request_id"]) >= 8 for line in logged)


def test_a_stopped_server_finishes_the_upload_under_way(
    topology: Topology, make_file: Callable[[float], bytes]
) -> None:
    held = HeldUpload(topology, make_file(7), "stopped")
    topology.wait_until(lambda: topology.readiness().get("is_ready"), "the server")
    codes: list[int] = []
    stopping = threading.Thread(target=lambda: codes.append(topology.server.stop(60)))
    stopping.start()
    topology.wait_until(lambda: not topology.readiness(), "the server to take nothing new")
    assert not codes, "it waits for the upload"
    status, view = held.finish()
    stopping.join(60)
    assert status == 202
    assert codes == [-signal.SIGTERM], "Uvicorn ends by the signal once it has answered"
    topology.server.start()
    topology.wait_until(lambda: topology.readiness().get("is_ready"), "the server to be back")
    wait_for_scores(topology, [view["id"]])


def test_it_runs_on_a_schema_newer_than_itself_before_and_after_a_restart(
    topology: Topology, make_file: Callable[[float], bytes]
) -> None:
    """The minutes of an upgrade, and its taking back: migrations only add."""
    with topology.database.write() as session:
        session.execute(text("ALTER TABLE submissions ADD COLUMN added_later VARCHAR"))
        session.execute(text("ALTER TABLE work ADD COLUMN added_later VARCHAR"))
        session.execute(text("CREATE TABLE made_later (id INTEGER PRIMARY KEY)"))
        session.execute(text("UPDATE alembic_version SET version_num = '9999'"))
    running = post(topology, make_file(8), "running")
    assert running.status_code == 202
    wait_for_scores(topology, [running.json()["id"]])
    parts = (topology.server, *topology.reconcilers, *topology.workers)
    starts = [part.starts for part in parts]
    for part in parts:
        part.stop(60)
        part.start()
    topology.wait_until(lambda: topology.readiness().get("live_workers", 0) >= 2, "a start")
    restarted = post(topology, make_file(9), "restarted")
    assert restarted.status_code == 202
    wait_for_scores(topology, [restarted.json()["id"]])
    assert [part.starts for part in parts] == [n + 1 for n in starts], "nothing starts in vain"
