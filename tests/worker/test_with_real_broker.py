"""A real broker, a real database and a real worker, and everything that may die in between.

Every accepted submission ends scored, once: whatever is killed, flushed or delivered again.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from sqlalchemy import select
from tests.chaos.junk import JUNK, MARK
from tests.worker.real_broker import (
    QUICK,
    assert_all_scored_once,
    count_scored,
    live_slots,
)

from exceptiondrive_records.boards.boards import current_board
from exceptiondrive_records.work.doorbell import Doorbell
from exceptiondrive_records.work.ringing import ring_job
from exceptiondrive_records.work.tables import Job
from exceptiondrive_schemas.board import Board
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_schemas.split import Split
from exceptiondrive_worker.rings import why_no_ring

World = Any


def test_an_upload_becomes_an_entry_of_a_board(
    make_world: Callable[..., World],
    database_url: str,
    broker_url: str,
    tiny: Split,
    planning_file: Callable[..., bytes],
    run_worker: Callable[..., Any],
    run_reconciler: Callable[[World], None],
    wait_until: Callable[..., None],
) -> None:
    world = make_world(database_url, broker_url=broker_url, **QUICK)
    world.add_phase(tiny)
    worker = run_worker(world, "--concurrency", "2")
    run_reconciler(world)
    submission_id, job_id = world.submit(planning_file(tiny))
    doorbell = Doorbell(broker_url)
    assert ring_job(world.database, doorbell, job_id, world.settings)
    wait_until(lambda: count_scored(world) == 1, "the submission to be scored")

    def board() -> Board | None:
        with world.database.read() as session:
            row = current_board(session, "dev")
        return None if row is None else Board.model_validate_json(row.body)

    wait_until(lambda: (found := board()) is not None and found.entries, "a board with the entry")
    found = board()
    assert found is not None
    assert [(row.submission_id, row.rank) for row in found.entries] == [(submission_id, 1)]
    wait_until(lambda: live_slots(world) == 2, "both processes to give a sign of life")
    assert worker.stop() == 0
    doorbell.close()
    assert live_slots(world) == 0, "a stopped worker signs off"


def test_a_job_delivered_five_times_is_scored_once(
    embedded: World,
    tiny: Split,
    planning_file: Callable[..., bytes],
    run_worker: Callable[..., Any],
    wait_until: Callable[..., None],
    broker: Any,
) -> None:
    embedded.add_phase(tiny)
    submission_id, job_id = embedded.submit(planning_file(tiny))
    doorbell = Doorbell(embedded.settings.broker_url)
    assert all(doorbell.ring_score(job_id) for _ in range(5))
    run_worker(embedded)

    def is_drained() -> bool:
        with broker.client() as client:
            return not any(client.type(key) == b"list" for key in client.keys("ed:*"))

    wait_until(is_drained, "the worker to take all five messages")
    wait_until(lambda: count_scored(embedded) == 1, "the submission to be scored")
    doorbell.close()
    assert_all_scored_once(embedded, [submission_id])
    assert embedded.job(job_id).attempts == 1


def test_live_jobs_overtake_rescoring(
    embedded: World,
    tiny: Split,
    planning_file: Callable[..., bytes],
    run_worker: Callable[..., Any],
    wait_until: Callable[..., None],
) -> None:
    embedded.add_phase(tiny)
    doorbell = Doorbell(embedded.settings.broker_url)
    job_ids = {}
    for i, lane in enumerate([Lane.RESCORE] * 8 + [Lane.LIVE] * 2):
        _, job_id = embedded.submit(planning_file(tiny, edited_mps=i / 10), method=f"m{i}")
        job_ids[job_id] = lane
        with embedded.database.write() as session:
            session.get_one(Job, job_id).lane = lane
        assert doorbell.ring_score(job_id, lane)
    doorbell.close()
    run_worker(embedded, "--concurrency", "1")
    wait_until(lambda: count_scored(embedded) == 10, "all to be scored")
    with embedded.database.read() as session:
        query = select(Job.id).order_by(Job.leased_at)
        order = [job_ids[job_id] for job_id in session.scalars(query)]
    # with prefetch switched off, one message may be taken before the first is begun
    assert set(order[:3]) >= {Lane.LIVE}
    assert order[:3].count(Lane.LIVE) == 2


def test_a_quiet_team_overtakes_a_flood_that_is_rung_already(
    make_world: Callable[..., World],
    database_url: str,
    broker_url: str,
    tiny: Split,
    planning_file: Callable[..., bytes],
    run_worker: Callable[..., Any],
    wait_until: Callable[..., None],
) -> None:
    """No reconciler runs: the worker itself keeps ringing until nothing waits."""
    world = make_world(database_url, broker_url=broker_url, **QUICK)
    world.add_phase(tiny)
    doorbell = Doorbell(broker_url)

    def submit(team: str, n: int) -> list[str]:
        made = []
        for i in range(n):
            data = planning_file(tiny, edited_mps=1 + i / 10)
            made.append(world.submit(data, method=f"m{i}", team=team)[1])
            ring_job(world.database, doorbell, made[-1], world.settings)
        return made

    flood = submit("flood", 12)
    quiet = submit("quiet", 2)
    doorbell.close()
    worker = run_worker(world, "--concurrency", "2")
    wait_until(lambda: count_scored(world) == 14, "all to be scored")
    assert worker.stop() == 0
    with world.database.read() as session:
        order = list(session.scalars(select(Job.id).order_by(Job.leased_at)))
    assert order.index(quiet[0]) <= 1, "before the flood's second file"
    assert order.index(quiet[1]) <= 4
    assert [job for job in order if job in flood] == flood


def test_nothing_but_ids_goes_through_the_broker(
    embedded: World, tiny: Split, planning_file: Callable[..., bytes], broker: Any
) -> None:
    embedded.add_phase(tiny)
    _, job_id = embedded.submit(planning_file(tiny))
    doorbell = Doorbell(embedded.settings.broker_url)
    assert doorbell.ring_score(job_id)
    doorbell.close()
    with broker.client() as client:
        (message,) = client.lrange("ed:live", 0, -1)
    assert why_no_ring(message) is None
    body = json.loads(message)["headers"]
    assert body["argsrepr"] == f"('{job_id}',)"
    assert body["kwargsrepr"] == "{}"


def test_junk_in_a_queue_ends_no_worker(
    embedded: World,
    tiny: Split,
    planning_file: Callable[..., bytes],
    run_worker: Callable[..., Any],
    wait_until: Callable[..., None],
    broker: Any,
    tmp_path: Path,
) -> None:
    embedded.add_phase(tiny)
    _, job_id = embedded.submit(planning_file(tiny))
    worker = run_worker(embedded)
    wait_until(lambda: live_slots(embedded) > 0, "the worker to begin")
    with broker.client() as client:
        for junk in JUNK.values():
            client.lpush("ed:live", junk)
        for command in ({}, {"method": "shutdown", "arguments": {}}):
            assert client.publish("ed:/0.celery.pidbox", json.dumps(command)) == 0, "nobody hears"
    doorbell = Doorbell(embedded.settings.broker_url)
    assert doorbell.ring_score(job_id)
    doorbell.close()
    wait_until(lambda: count_scored(embedded) == 1, "the submission behind the junk to be scored")
    assert worker.process.poll() is None, "junk ended the worker"
    assert worker.stop() == 0
    log = (tmp_path / "worker.log").read_text()
    events = [json.loads(line)["event"] for line in parsed(log.splitlines())]
    assert events.count("junk dropped from a queue") == len(JUNK)
    assert events.count("worker starts") == 1
    assert MARK not in log


def parsed(lines: list[str]) -> list[str]:
    return [line for line in lines if line.startswith("{")]


def test_the_worker_writes_one_json_object_per_log_line(
    embedded: World,
    tiny: Split,
    planning_file: Callable[..., bytes],
    run_worker: Callable[..., Any],
    run_reconciler: Callable[[World], None],
    wait_until: Callable[..., None],
    tmp_path: Path,
) -> None:
    embedded.add_phase(tiny)
    submission_id, job_id = embedded.submit(planning_file(tiny))
    worker = run_worker(embedded)
    run_reconciler(embedded)
    wait_until(lambda: count_scored(embedded) == 1, "the submission to be scored")
    assert worker.stop() == 0
    lines = [line for line in (tmp_path / "worker.log").read_text().splitlines() if line]
    events = {json.loads(line)["event"] for line in parsed(lines)}
    assert {"worker starts", "scored"} <= events
    (scored,) = [line for line in map(json.loads, parsed(lines)) if line["event"] == "scored"]
    assert (scored["submission"], scored["job"]) == (submission_id, job_id)
    assert [line for line in lines if not line.startswith("{")] == [
        "worker: Warm shutdown (MainProcess)"  # Celery's own, past all logging
    ]
