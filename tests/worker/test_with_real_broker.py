"""A real broker, a real database and a real worker, and everything that may die in between.

Every accepted submission ends scored, once: whatever is killed, flushed or delivered again.
"""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from sqlalchemy import select
from tests.chaos.junk import JUNK, MARK, message
from tests.worker.real_broker import (
    QUICK,
    assert_all_scored_once,
    count_scored,
    n_alive,
)

from exceptiondrive_records.boards.boards import current_board
from exceptiondrive_records.work.dispatch import Dispatcher, wake_lanes
from exceptiondrive_records.work.tables import Job
from exceptiondrive_schemas.board import Board
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_schemas.split import Split
from exceptiondrive_worker.app import why_junk

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
    submission_id, _ = world.submit(planning_file(tiny))
    dispatcher = Dispatcher(broker_url)
    assert wake_lanes(world.database, dispatcher, world.settings)
    wait_until(lambda: count_scored(world) == 1, "the submission to be scored")

    def ranks() -> dict[str, int | None]:
        with world.database.read() as session:
            row = current_board(session, "dev")
            rows = () if row is None else Board.model_validate_json(row.body).entries
        return {row.submission_id: row.rank for row in rows if row.submission_id}

    wait_until(ranks, "a board with the entry")
    assert ranks() == {submission_id: 1}
    wait_until(lambda: n_alive(world) == 2, "both processes to give a sign of life")
    assert worker.stop() == 0
    dispatcher.close()
    assert n_alive(world) == 0, "a stopped worker signs off"


def test_a_worker_that_is_woken_five_times_scores_once(
    embedded: World,
    tiny: Split,
    planning_file: Callable[..., bytes],
    run_worker: Callable[..., Any],
    wait_until: Callable[..., None],
    broker: Any,
) -> None:
    embedded.add_phase(tiny)
    submission_id, job_id = embedded.submit(planning_file(tiny))
    dispatcher = Dispatcher(embedded.settings.broker_url)
    assert dispatcher.wake(Lane.LIVE, at_most=5)
    run_worker(embedded)

    def is_drained() -> bool:
        with broker.client() as client:
            return not any(client.type(key) == b"list" for key in client.keys("ed:*"))

    wait_until(is_drained, "the worker to take all five messages")
    wait_until(lambda: count_scored(embedded) == 1, "the submission to be scored")
    dispatcher.close()
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
    dispatcher = Dispatcher(embedded.settings.broker_url)
    job_ids = {}
    for i, lane in enumerate([Lane.RESCORE] * 8 + [Lane.LIVE] * 2):
        _, job_id = embedded.submit(planning_file(tiny, edited_mps=i / 10), method=f"m{i}")
        job_ids[job_id] = lane
        with embedded.database.write() as session:
            session.get_one(Job, job_id).lane = lane
        assert dispatcher.wake(lane)
    dispatcher.close()
    run_worker(embedded, "--concurrency", "1")
    wait_until(lambda: count_scored(embedded) == 10, "all to be scored")
    with embedded.database.read() as session:
        query = select(Job.id).order_by(Job.leased_at)
        order = [job_ids[job_id] for job_id in session.scalars(query)]
    assert order[:2] == [Lane.LIVE, Lane.LIVE]


def test_a_quiet_team_overtakes_a_flood(
    make_world: Callable[..., World],
    database_url: str,
    broker_url: str,
    tiny: Split,
    planning_file: Callable[..., bytes],
    run_worker: Callable[..., Any],
    wait_until: Callable[..., None],
) -> None:
    """No reconciler runs: the worker itself goes on until nothing waits.

    With one slot there is one right order; with more, the times of two claims that overlap say
    nothing of who came first (`tests/records/test_fair_share.py` claims at once).
    """
    world = make_world(database_url, broker_url=broker_url, **QUICK)
    world.add_phase(tiny)
    dispatcher = Dispatcher(broker_url)

    def submit(team: str, n: int) -> list[str]:
        made = []
        for i in range(n):
            data = planning_file(tiny, edited_mps=1 + i / 10)
            made.append(world.submit(data, method=f"m{i}", team=team)[1])
            wake_lanes(world.database, dispatcher, world.settings)
        return made

    flood = submit("flood", 12)
    quiet = submit("quiet", 2)
    dispatcher.close()
    worker = run_worker(world, "--concurrency", "1")
    wait_until(lambda: count_scored(world) == 14, "all to be scored")
    assert worker.stop() == 0
    with world.database.read() as session:
        order = list(session.scalars(select(Job.id).order_by(Job.leased_at)))
    assert order == [flood[0], quiet[0], flood[1], quiet[1], *flood[2:]]


def test_nothing_but_a_lane_goes_through_the_broker(
    embedded: World, tiny: Split, planning_file: Callable[..., bytes], broker: Any
) -> None:
    embedded.add_phase(tiny)
    embedded.submit(planning_file(tiny))
    dispatcher = Dispatcher(embedded.settings.broker_url)
    assert wake_lanes(embedded.database, dispatcher, embedded.settings)
    dispatcher.close()
    with broker.client() as client:
        (sent,) = client.lrange("ed:live", 0, -1)
    assert why_junk(sent) is None
    body = json.loads(sent)["headers"]
    assert body["argsrepr"] == "('live',)"
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
    embedded.submit(planning_file(tiny))
    worker = run_worker(embedded)
    wait_until(lambda: n_alive(embedded) > 0, "the worker to begin")
    with broker.client() as client:
        for junk in JUNK.values():
            client.lpush("ed:live", junk)
        for field in ("stamped_headers", "stamps", "errbacks", "chord", "group", "callbacks"):
            client.lpush("ed:live", message(headers={field: 1}))
        for command in ({}, {"method": "shutdown", "arguments": {}}):
            assert client.publish("ed:/0.celery.pidbox", json.dumps(command)) == 0, "nobody hears"
    dispatcher = Dispatcher(embedded.settings.broker_url)
    assert dispatcher.wake(Lane.LIVE, at_most=len(JUNK) + 10)
    dispatcher.close()
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
