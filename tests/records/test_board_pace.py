"""Boards: at once on an idle system, paced in a rush, and always one after the last score."""

from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
from sqlalchemy import update

from exceptiondrive_records.boards import boards
from exceptiondrive_records.db.settings import RecordsSettings
from exceptiondrive_records.work.board_rings import (
    LONGEST_PAUSE_S,
    PAUSE_FACTOR,
    build_after,
    due_boards,
    ring_boards,
    ring_due_boards,
    take_due_boards,
)
from exceptiondrive_records.work.doorbell import Doorbell
from exceptiondrive_records.work.tables import BoardRequest
from exceptiondrive_schemas.board import Board
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.score_sheet import ProtocolRef
from exceptiondrive_schemas.split import SplitRef

World = Any
SETTINGS = RecordsSettings()
NOON = datetime(2026, 11, 21, 12, tzinfo=UTC)


def n_due(world: World) -> int:
    with world.database.read() as session:
        return len(due_boards(session, SETTINGS))


def take(world: World) -> list[Any]:
    with world.database.write() as session:
        return take_due_boards(session, SETTINGS)


def built(world: World) -> None:
    """A worker comes and builds the board."""
    with world.database.write() as session:
        claim = boards.claim_board(session, "dev", world.protocol_digest, 30)
    assert claim is not None
    with world.database.write() as session:
        assert boards.publish_board(session, claim, board_of(world)) is not None


def board_of(world: World) -> Board:
    sheet = world.sheet()
    return Board(
        challenge=PLANNING.id,
        phase="dev",
        split=SplitRef(name="sample", revision=sheet.split.revision),
        protocol=ProtocolRef(version="1.0", digest=world.protocol_digest),
        headline="macro_family",
        board=0,
        published_at=NOON,
        n_samples=3,
        confidence=0.95,
        families=(),
        entries=(),
    )


def set_pace(world: World, *, build_s: float, ended_s_ago: float) -> None:
    with world.database.write() as session:
        row = session.query(BoardRequest).one()
        row.built_at = row.built_at - timedelta(seconds=ended_s_ago)
        row.build_s = build_s


@pytest.mark.parametrize(
    ("build_s", "pause_s"), [(0.0, 0.0), (0.1, 0.4), (2.0, 8.0), (60.0, LONGEST_PAUSE_S)]
)
def test_the_pause_grows_with_the_last_build_up_to_a_bound(build_s: float, pause_s: float) -> None:
    assert PAUSE_FACTOR == 4
    assert build_after(NOON, build_s) == NOON + timedelta(seconds=pause_s)


def test_what_was_never_built_waits_for_nothing() -> None:
    assert build_after(None, None) is None


def test_an_idle_system_builds_after_every_score_at_once(world: World) -> None:
    built(world)
    set_pace(world, build_s=100, ended_s_ago=0)
    world.score(world.submit("file").job_id)
    assert n_due(world) == 1


def test_while_live_jobs_wait_the_next_build_pauses(world: World) -> None:
    built(world)
    set_pace(world, build_s=2, ended_s_ago=1)
    done, waiting = world.submit("done"), world.submit("waiting")
    world.score(done.job_id)
    assert n_due(world) == 0
    set_pace(world, build_s=2, ended_s_ago=8)
    assert n_due(world) == 1, "four times as long as the build took"
    set_pace(world, build_s=100, ended_s_ago=-8)
    assert n_due(world) == 0
    world.claim(waiting.job_id)
    assert n_due(world) == 1, "nothing waits any more: the last score is shown at once"


def test_no_board_lags_behind_for_long(world: World) -> None:
    built(world)
    set_pace(world, build_s=3600, ended_s_ago=LONGEST_PAUSE_S)
    world.score(world.submit("done").job_id)
    world.submit("waiting")
    assert n_due(world) == 1


def test_a_taken_board_is_not_due_again_until_its_ring_is_lost(world: World) -> None:
    assert len(take(world)) == 1
    world.score(world.submit("file").job_id)
    assert take(world) == [], "the message under way builds for the new score too"
    with world.database.write() as session:
        session.execute(update(BoardRequest).values(rung_at=NOON - timedelta(days=1000)))
    assert len(take(world)) == 1


def test_a_build_under_way_is_followed_by_one_for_what_came_meanwhile(world: World) -> None:
    take(world)
    with world.database.write() as session:
        claim = boards.claim_board(session, "dev", world.protocol_digest, 30)
    assert claim is not None
    world.score(world.submit("file").job_id)
    assert n_due(world) == 0, "one build at a time"
    with world.database.write() as session:
        boards.publish_board(session, claim, board_of(world))
    assert n_due(world) == 1


def test_a_mark_that_comes_late_does_not_hide_the_next_board(world: World, broker: Any) -> None:
    taken = take(world)
    with world.database.write() as session:
        assert boards.claim_board(session, "dev", world.protocol_digest, 30) is not None
    broker.kill()
    ring_boards(world.database, Doorbell(broker.url), taken)
    with world.database.write() as session:
        row = session.query(BoardRequest).one()
        row.rung_at = NOON
    ring_boards(world.database, Doorbell(broker.url), taken)
    with world.database.read() as session:
        assert session.query(BoardRequest).one().rung_at == NOON, "the claim came between"


def test_a_ring_that_the_broker_does_not_take_is_due_again(world: World, broker: Any) -> None:
    broker.kill()
    bell = Doorbell(broker.url)
    assert ring_due_boards(world.database, bell, SETTINGS) == 0
    assert n_due(world) == 1
    bell.close()
