"""Workers are killed and brokers die or forget: every accepted submission ends scored, once."""

from collections.abc import Callable
from typing import Any

import pytest
from sqlalchemy import select
from tests.worker.real_broker import assert_all_scored_once, count_leased, count_scored, submit_many

from exceptiondrive_records.work.dispatch import Dispatcher, wake_lanes
from exceptiondrive_records.work.tables import Job
from exceptiondrive_schemas.split import Split

World = Any


@pytest.fixture(scope="session")
def large(make_split: Callable[..., Split]) -> Split:
    """A split that takes a worker long enough to be killed while it scores."""
    samples = {
        f"s{number:05}": {"scene_id": f"scene-{number % 50}", "task": ("SE1", "LB1")[number % 2]}
        for number in range(5000)
    }
    return make_split(samples, name="large")


@pytest.mark.slow
def test_killed_processes_lose_and_double_nothing(
    embedded: World,
    large: Split,
    planning_file: Callable[..., bytes],
    run_worker: Callable[..., Any],
    run_reconciler: Callable[[World], None],
    wait_until: Callable[..., None],
) -> None:
    embedded.add_phase(large)
    submission_ids = submit_many(embedded, large, planning_file, 5)
    worker = run_worker(embedded)
    run_reconciler(embedded)
    wait_until(lambda: count_leased(embedded) > 0, "a scoring run to begin")
    assert worker.kill_children() > 0
    wait_until(lambda: count_scored(embedded) == len(submission_ids), "all to be scored")
    assert_all_scored_once(embedded, submission_ids)
    with embedded.database.read() as session:
        attempts = list(session.scalars(select(Job.attempts)))
    assert max(attempts) > 1, "the kill came too late to prove anything"


@pytest.mark.slow
def test_a_killed_worker_loses_and_doubles_nothing(
    embedded: World,
    large: Split,
    planning_file: Callable[..., bytes],
    run_worker: Callable[..., Any],
    run_reconciler: Callable[[World], None],
    wait_until: Callable[..., None],
) -> None:
    embedded.add_phase(large)
    submission_ids = submit_many(embedded, large, planning_file, 5)
    worker = run_worker(embedded)
    run_reconciler(embedded)
    wait_until(lambda: count_leased(embedded) > 0, "a scoring run to begin")
    worker.kill_all()
    assert count_scored(embedded) < len(submission_ids)
    run_worker(embedded)
    wait_until(lambda: count_scored(embedded) == len(submission_ids), "all to be scored")
    assert_all_scored_once(embedded, submission_ids)


def test_a_flushed_broker_loses_nothing(
    embedded: World,
    tiny: Split,
    planning_file: Callable[..., bytes],
    run_worker: Callable[..., Any],
    run_reconciler: Callable[[World], None],
    wait_until: Callable[..., None],
    broker: Any,
) -> None:
    embedded.add_phase(tiny)
    submission_ids = []
    dispatcher = Dispatcher(embedded.settings.broker_url)
    for i in range(10):
        submission_ids.append(
            embedded.submit(planning_file(tiny, edited_mps=i / 10), method=f"m{i}")[0]
        )
        assert wake_lanes(embedded.database, dispatcher, embedded.settings)
    dispatcher.close()
    with broker.client() as client:
        assert client.dbsize() > 0
        client.flushall()
    run_worker(embedded)
    run_reconciler(embedded)
    wait_until(lambda: count_scored(embedded) == len(submission_ids), "all to be scored")
    assert_all_scored_once(embedded, submission_ids)


def test_a_broker_that_dies_and_comes_back_empty_loses_nothing(
    embedded: World,
    tiny: Split,
    planning_file: Callable[..., bytes],
    run_worker: Callable[..., Any],
    run_reconciler: Callable[[World], None],
    wait_until: Callable[..., None],
    broker: Any,
) -> None:
    embedded.add_phase(tiny)
    worker = run_worker(embedded)
    run_reconciler(embedded)
    first = submit_many(embedded, tiny, planning_file, 3)
    wait_until(lambda: count_scored(embedded) == 3, "the first three to be scored")
    broker.kill()
    second = [
        embedded.submit(planning_file(tiny, edited_mps=3 + i / 10), method=f"later{i}")[0]
        for i in range(3)
    ]
    broker.start()
    if worker.process.poll() is not None:  # Celery 5.7 sometimes exits; a supervisor restarts it
        run_worker(embedded)

    def all_scored() -> bool:
        if worker.process.poll() is not None and not restarted:
            restarted.append(run_worker(embedded))
        return count_scored(embedded) == 6

    restarted: list[Any] = []
    wait_until(all_scored, "all six to be scored")
    assert_all_scored_once(embedded, [*first, *second])
