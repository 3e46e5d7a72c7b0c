import errno
from collections.abc import Callable, Iterable, Iterator
from datetime import timedelta
from typing import Any

import structlog

from exceptiondrive_records.db.database import Database
from exceptiondrive_records.work.heartbeats import live_workers
from exceptiondrive_records.work.tables import WorkerHeartbeat
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_worker.failures import run_job
from exceptiondrive_worker.heartbeat import Heartbeat, youngest_heartbeat_age_s


def n_alive(database: Database, lane: Lane) -> int:
    with database.read() as session:
        return live_workers(session, lane)


def test_every_process_counts_until_it_signs_off(
    database: Database, wait_until: Callable[..., Any]
) -> None:
    both = [Heartbeat(database, (Lane.LIVE,), every_s=0.05, ttl_s=15) for _ in range(2)]
    assert both[0].worker_id != both[1].worker_id
    for heartbeat in both:
        heartbeat.start()
    wait_until(lambda: n_alive(database, Lane.LIVE) == 2, "two signs of life")
    assert n_alive(database, Lane.RESCORE) == 0
    both[0].stop()
    assert n_alive(database, Lane.LIVE) == 1
    both[1].stop()
    assert n_alive(database, Lane.LIVE) == 0


def test_a_sign_of_life_holds_for_as_long_as_the_worker_is_set_to(
    database: Database, wait_until: Callable[..., Any]
) -> None:
    heartbeat = Heartbeat(database, (Lane.LIVE,), every_s=0.05, ttl_s=600)
    heartbeat.start()
    wait_until(lambda: n_alive(database, Lane.LIVE) == 1, "a sign of life")
    with database.read() as session:
        (sign,) = session.query(WorkerHeartbeat)
        assert sign.lives_until - sign.at == timedelta(seconds=600)
    heartbeat.stop()


def test_the_age_of_the_youngest_heartbeat_is_told(
    database: Database, wait_until: Callable[..., Any]
) -> None:
    assert youngest_heartbeat_age_s(database) is None
    heartbeat = Heartbeat(database, (Lane.LIVE,), every_s=0.05, ttl_s=15)
    heartbeat.start()
    wait_until(lambda: youngest_heartbeat_age_s(database) is not None, "a sign of life")
    age_s = youngest_heartbeat_age_s(database)
    heartbeat.stop()
    assert age_s is not None
    assert 0 <= age_s < 15


def test_a_folder_of_splits_that_is_away_for_a_moment_ends_no_heartbeat(
    database: Database, wait_until: Callable[..., Any]
) -> None:
    answers: Iterator[list[str] | OSError] = iter([OSError(errno.ESTALE, "stale")])

    def missing(_: Iterable[str]) -> list[str]:
        answer = next(answers, [])
        if isinstance(answer, OSError):
            raise answer
        return answer

    heartbeat = Heartbeat(database, (Lane.LIVE,), every_s=0.05, ttl_s=15, missing=missing)
    heartbeat.start()
    wait_until(lambda: n_alive(database, Lane.LIVE) == 1, "a sign of life")
    heartbeat.stop()


def test_what_a_database_said_that_refuses_a_running_worker_stands_in_its_log(
    wait_until: Callable[..., Any],
) -> None:
    """As after its password was changed: without it nobody knows whether to start the worker or the database."""
    away = Database("postgresql+psycopg://worker:hush@127.0.0.1:1/records")
    heartbeat = Heartbeat(away, (Lane.LIVE,), every_s=0.05, ttl_s=15)
    with structlog.testing.capture_logs() as lines:
        heartbeat.start()
        wait_until(lambda: lines, "a sign of life that was not recorded")
        heartbeat.stop()
        run_job("live", lambda: n_alive(away, Lane.LIVE), lambda _: None)
    away.dispose()
    said = {line["event"]: line.get("reason", "") for line in lines}
    for event in ("heartbeat not recorded", "job failed"):
        assert said[event].startswith("the database does not answer: connection failed")
    assert "hush" not in str(lines)
