"""Boards: at once on an idle system, paced in a rush, and always one after the last score."""

import re
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import func, select

import exceptiondrive_server
from exceptiondrive_records.boards import boards
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.work.board_requests import (
    LEAST_PAUSE_S,
    LONGEST_PAUSE_S,
    PAUSE_FACTOR,
    is_due,
    pause_after,
)
from exceptiondrive_records.work.tables import BoardRequest, Job
from exceptiondrive_schemas.jobs import Lane

World = Any
NOON = datetime(2026, 11, 21, 12, tzinfo=UTC)
LIVE_JS = Path(exceptiondrive_server.__path__[0]) / "web" / "static" / "live.js"


def n_due(world: World) -> int:
    with world.database.read() as session:
        due = select(func.count(BoardRequest.id)).where(is_due(Lane.LIVE))
        return session.scalar(due) or 0


def request_of(world: World) -> BoardRequest:
    with world.database.read() as session:
        request: BoardRequest = session.scalars(select(BoardRequest)).one()
        return request


def set_pace(world: World, *, build_s: float, ended_s_ago: float) -> None:
    with world.database.write() as session:
        row = session.query(BoardRequest).one()
        pause_s = pause_after(build_s) - ended_s_ago
        assert row.leased_at is not None
        row.available_at = row.leased_at + timedelta(seconds=pause_s)


@pytest.mark.parametrize(
    ("build_s", "pause_s"),
    [(0.0, LEAST_PAUSE_S), (0.1, LEAST_PAUSE_S), (0.6, 2.4), (2.0, 8.0), (60.0, LONGEST_PAUSE_S)],
)
def test_the_pause_grows_with_the_last_build_between_bounds(build_s: float, pause_s: float) -> None:
    assert PAUSE_FACTOR == 4
    assert pause_after(build_s) == pause_s


def test_boards_come_as_often_as_pages_look_for_them() -> None:
    looks = re.search(r"ASK_EVERY_MS = (\d+);", LIVE_JS.read_text())
    assert looks is not None
    assert LEAST_PAUSE_S <= int(looks[1]) / 1000


def test_the_pause_begins_when_a_build_ends(world: World) -> None:
    claim = world.claim_board()
    assert claim is not None
    assert claim.leased_at is not None
    claim.leased_at -= timedelta(seconds=2)
    with world.database.write() as session:
        assert boards.publish_board(session, claim, world.board()) is not None
    with world.database.read() as session:
        row = session.query(BoardRequest).one()
    assert row.took_s == pytest.approx(2, abs=1)
    assert row.available_at - row.finished_at == pytest.approx(
        timedelta(seconds=4 * row.took_s), abs=timedelta(seconds=0.1)
    )


def test_what_was_never_built_waits_for_nothing(world: World) -> None:
    world.submit("waiting")
    assert n_due(world) == 1


def test_an_idle_system_builds_after_every_score_at_once(world: World) -> None:
    world.publish(world.board())
    set_pace(world, build_s=100, ended_s_ago=0)
    world.scored("file")
    assert n_due(world) == 1


def test_while_live_jobs_wait_or_are_scored_the_next_build_pauses(world: World) -> None:
    world.publish(world.board())
    set_pace(world, build_s=2, ended_s_ago=1)
    done, waiting = world.submit("done"), world.submit("waiting")
    world.score(done.job_id)
    assert n_due(world) == 0
    set_pace(world, build_s=2, ended_s_ago=8)
    assert n_due(world) == 1, "four times as long as the build took"
    set_pace(world, build_s=100, ended_s_ago=-8)
    assert n_due(world) == 0
    claim = world.claim(waiting.job_id)
    assert n_due(world) == 0, "its score is to be on the board, too"
    world.finish(claim)
    assert n_due(world) == 1, "nothing is left to score: the last score is shown at once"


def test_a_job_whose_worker_died_keeps_no_board_back_once_its_lease_has_run_out(
    world: World,
) -> None:
    world.publish(world.board())
    world.scored("done")
    lost = world.submit("lost")
    set_pace(world, build_s=100, ended_s_ago=0)
    world.claim(lost.job_id)
    assert n_due(world) == 0
    with world.database.write() as session:
        session.get_one(Job, lost.job_id).lease_until = NOON - timedelta(days=1000)
        session.get_one(Job, lost.job_id).available_at = NOON + timedelta(days=1000)
    assert n_due(world) == 1


def test_no_board_lags_behind_for_long(world: World) -> None:
    world.publish(world.board())
    world.scored("done")
    set_pace(world, build_s=3600, ended_s_ago=LONGEST_PAUSE_S)
    world.submit("waiting")
    assert n_due(world) == 1


def test_the_first_score_of_a_rush_waits_as_readers_do_and_the_next_put_nothing_off(
    world: World,
) -> None:
    world.publish(world.board())
    set_pace(world, build_s=2, ended_s_ago=3600)
    first, second, third = (world.submit(name) for name in ("first", "second", "third"))
    world.score(first.job_id)
    assert n_due(world) == 0
    due_at = request_of(world).available_at
    with world.database.read() as session:
        wait = due_at - database_now(session)
    assert timedelta(0) < wait <= timedelta(seconds=LEAST_PAUSE_S)
    world.score(second.job_id)
    assert request_of(world).available_at == due_at
    world.score(third.job_id)
    assert n_due(world) == 1, "nothing is left to score"


def test_a_board_is_asked_for_once_however_many_scores_want_it(world: World) -> None:
    for i in range(3):
        world.scored(f"file {i}")
    assert n_due(world) == 1
    world.publish(world.board())
    assert n_due(world) == 0, "one build shows all of them"


def test_a_build_under_way_is_followed_by_one_for_what_came_meanwhile(world: World) -> None:
    claim = world.claim_board()
    assert claim is not None
    world.scored("file")
    assert n_due(world) == 0, "one build at a time"
    with world.database.write() as session:
        boards.publish_board(session, claim, world.board())
    assert n_due(world) == 1


def test_a_build_that_lost_its_lease_publishes_nothing(world: World) -> None:
    frozen = world.claim_board()
    with world.database.write() as session:
        session.query(BoardRequest).one().lease_until = NOON - timedelta(days=1000)
    world.publish(world.board())
    with world.database.write() as session:
        assert frozen is not None
        assert boards.publish_board(session, frozen, world.board()) is None
