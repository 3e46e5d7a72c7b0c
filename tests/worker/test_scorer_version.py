"""An older scorer among newer ones scores nothing, and does not even begin."""

from collections.abc import Callable
from datetime import timedelta
from typing import Any

import pytest
from sqlalchemy import update
from typer.testing import CliRunner

from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.work.heartbeats import beat, forget_worker, newer_scorer
from exceptiondrive_records.work.tables import WorkerHeartbeat
from exceptiondrive_scoring import SCORER_VERSION
from exceptiondrive_worker.operator_cli import app
from exceptiondrive_worker.work import may_work

World = Any
NEWER = f"{int(SCORER_VERSION.split('.')[0]) + 1}.0"


@pytest.fixture
def world_on_both(make_world: Callable[..., World], database_url: str) -> World:
    return make_world(database_url)


def joined(world: World, version: str | None, worker_id: str = "another") -> None:
    with world.database.write() as session:
        beat(session, worker_id, scorer_version=version)


def may_work_now(world: World) -> bool:
    with world.database.read() as session:
        return may_work(session)


def test_a_newer_scorer_on_the_list_keeps_this_one_from_working(world_on_both: World) -> None:
    world = world_on_both
    for version in (None, SCORER_VERSION, "0.9"):
        joined(world, version)
        assert may_work_now(world), version
    joined(world, NEWER)
    assert not may_work_now(world)
    with world.database.write() as session:
        forget_worker(session, "another")  # it stopped in good order: going back is meant
    assert may_work_now(world)


def test_versions_are_compared_as_numbers(world: World) -> None:
    joined(world, "10")
    with world.database.read() as session:
        assert newer_scorer(session, "9") == "10"
        assert newer_scorer(session, "10.0.1") is None


def test_a_newer_scorer_that_died_counts_for_an_hour(world: World) -> None:
    joined(world, NEWER)
    for age, may in ((timedelta(minutes=59), False), (timedelta(minutes=61), True)):
        with world.database.write() as session:
            at = database_now(session) - age
            session.execute(update(WorkerHeartbeat).values(at=at))
        assert may_work_now(world) is may


def test_the_command_refuses_to_begin_and_says_what_to_do(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    joined(world, NEWER)
    for name, value in world.settings.model_dump().items():
        if value is not None:
            monkeypatch.setenv(f"EXCEPTIONDRIVE_{name.upper()}", str(value))
    done = CliRunner().invoke(app, ["run"])
    assert done.exit_code != 0
    assert f"version {NEWER} works already: upgrade this worker" in str(done.exception)
