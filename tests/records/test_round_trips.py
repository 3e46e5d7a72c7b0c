"""Nothing that others wait for is held over a round trip to PostgreSQL, and no question is asked for nothing."""

import os
import socket
from collections.abc import Callable, Iterator
from datetime import timedelta
from pathlib import Path
from statistics import median_low
from typing import Any
from urllib.parse import parse_qs

import pytest
from sqlalchemy import func, insert, make_url, select, text, update
from sqlalchemy.exc import DBAPIError, InvalidRequestError
from tests.chaos.proxy import Proxy
from tests.records.world import World
from tests.support.databases import POSTGRES_ALONE

from exceptiondrive_records.audit.log import audit, audit_page, verify_audit
from exceptiondrive_records.boards.boards import publish_board
from exceptiondrive_records.db import postgresql
from exceptiondrive_records.db.clock import NOW, database_now, seconds_from_now, seconds_since
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.db.last import do_last, require_last
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.work.board_requests import claim_board, want_board
from exceptiondrive_records.work.heartbeats import beat, live_workers
from exceptiondrive_records.work.jobs import finish_scored
from exceptiondrive_records.work.lease import LeaseLost
from exceptiondrive_records.work.tables import BoardRequest, Job, WorkerHeartbeat
from exceptiondrive_schemas.jobs import Lane


@pytest.fixture
def counted(database_url: str) -> Iterator[tuple[Database, Proxy]]:
    """The same records behind a proxy that counts."""
    address = make_url(database_url)
    folder = parse_qs(database_url.partition("?")[2])["host"][0]
    proxy = Proxy(Path(folder) / ".s.PGSQL.5432")
    database = Database(
        address.set(host="127.0.0.1", port=proxy.port, query={}).render_as_string(False)
    )
    with database.read() as session:  # the first connection is greeted at length
        session.execute(text("SELECT 1"))
    yield database, proxy
    database.dispose()
    proxy.close()


def round_trips(proxy: Proxy, what: Callable[[], Any]) -> float:
    """Count those of most times: on a full machine an answer may overtake what is sent without waiting."""
    counts = []
    for _ in range(12):
        before = proxy.n_round_trips
        what()
        counts.append(proxy.n_round_trips - before)
    # what comes again and again is prepared, once, in a round trip of its own
    return median_low(counts[6:])


@POSTGRES_ALONE
def test_a_question_is_one_round_trip_and_a_change_two(counted: tuple[Database, Proxy]) -> None:
    database, proxy = counted

    def ask() -> None:
        with database.read() as session:
            session.execute(text("SELECT 1"))

    def change() -> None:
        with database.write() as session:
            session.execute(update(Team).values(name="x"))

    assert (round_trips(proxy, ask), round_trips(proxy, change)) == (1, 2)


@POSTGRES_ALONE
def test_what_comes_last_and_its_audit_lines_are_one_round_trip(
    counted: tuple[Database, Proxy],
) -> None:
    """With the lock of the chain and the commit: whoever waits for it waits for no network."""
    database, proxy = counted

    def end() -> None:
        with database.write() as session:
            do_last(session, update(Team).values(name="x"))
            for number in range(3):
                audit(session, "test", "counted", "x", {"number": number})

    assert round_trips(proxy, end) == 1
    with database.read() as session:
        verdict = verify_audit(session)
    assert (verdict.is_whole, verdict.n_lines) == (True, 36)


@POSTGRES_ALONE
def test_two_scores_are_recorded_side_by_side(world: World) -> None:
    """What both take, the row of the board's request and the head of the chain, is taken last."""
    first, second = (world.claim(world.submit(content).job_id) for content in ("one", "two"))
    with world.database.write() as session:
        finish_scored(
            session,
            first,
            world.sheet(),
            exact_digest="sha256:1",
            measurement_key="m",
            scorer_version="1",
        )
        assert world.finish(second)  # or it waits for a lock, until it gives up
    with world.database.read() as session:
        assert {job.state for job in session.scalars(select(Job))} == {"done"}
        assert verify_audit(session).is_whole


@POSTGRES_ALONE
def test_scores_go_on_while_a_board_is_recorded(world: World) -> None:
    job = world.claim(world.submit("one").job_id)
    claim = world.claim_board()
    assert claim is not None
    with world.database.write() as session:
        assert publish_board(session, claim, world.board()) is not None
        assert world.finish(job)  # or it waits for a lock, until it gives up
    with world.database.read() as session:
        request = session.scalars(select(BoardRequest)).one()
    assert request.state == "queued"  # its score came while the board was built


def test_a_board_whose_build_was_claimed_anew_meanwhile_is_not_recorded(world: World) -> None:
    claim = world.claim_board()
    assert claim is not None

    def publish() -> None:
        with world.database.write() as session:
            assert publish_board(session, claim, world.board()) is not None
            session.execute(update(BoardRequest).values(fence=BoardRequest.fence + 1))

    with pytest.raises(LeaseLost):
        publish()
    with world.database.read() as session:
        assert session.scalar(text("SELECT count(*) FROM boards")) == 0
        assert session.scalars(select(BoardRequest)).one().state == "leased"


def test_a_condition_that_fails_at_the_end_keeps_nothing(database: Database) -> None:
    def change(least: int) -> None:
        with database.write() as session:
            audit(session, "test", "tried", "x")
            beat(session, "worker")
            n_workers = select(func.count(WorkerHeartbeat.worker_id)).scalar_subquery()
            require_last(session, n_workers >= least, {}, LookupError("too few"))

    with pytest.raises(LookupError):
        change(2)
    with database.read() as session:
        assert (verify_audit(session).n_lines, live_workers(session)) == (0, 0)
    change(1)
    with database.read() as session:
        assert (verify_audit(session).n_lines, live_workers(session)) == (1, 1)


def test_an_error_at_the_end_keeps_nothing_and_says_what_it_is(database: Database) -> None:
    def change() -> None:
        with database.write() as session:
            audit(session, "test", "tried", "x")
            for _ in range(2):
                values = {"at": NOW, "lives_until": NOW, "lanes": [], "missing_splits": []}
                do_last(session, insert(WorkerHeartbeat).values(worker_id="one", **values))

    with pytest.raises(DBAPIError) as error:
        change()
    assert type(error.value).__name__ == "IntegrityError"
    with database.read() as session:
        assert (verify_audit(session).n_lines, live_workers(session)) == (0, 0)


def test_what_reads_changes_nothing(world: World) -> None:
    def change() -> None:
        with world.database.read() as session:
            session.get_one(Team, world.team_id).name = "changed"
            session.flush()

    with pytest.raises(RuntimeError, match="reads"):
        change()
    with world.database.read() as session:
        assert session.get_one(Team, world.team_id).name != "changed"


@pytest.mark.parametrize("kind", ["read", "write", "claim"])
def test_a_session_asks_nothing_once_its_block_is_over(world: World, kind: str) -> None:
    with getattr(world.database, kind)() as session:
        team = session.get_one(Team, world.team_id)
    assert team.name, "what was read stays readable"
    with pytest.raises(InvalidRequestError):
        session.scalar(select(Team.id))


def test_many_changes_at_once_are_one_transaction(database: Database) -> None:
    """As the first statement, too: the driver opens no transaction by itself."""
    rows = [{"worker_id": str(n), "lanes": [], "missing_splits": []} for n in range(3)]

    def change() -> None:
        with database.write() as session:
            session.connection().execute(
                insert(WorkerHeartbeat).values(at=NOW, lives_until=NOW), rows
            )
            raise LookupError

    with pytest.raises(LookupError):
        change()
    with database.read() as session:
        assert live_workers(session) == 0


def test_what_is_read_row_by_row_may_stand_beside_other_questions(database: Database) -> None:
    for number in range(3):
        with database.write() as session:
            audit(session, "test", "counted", str(number))
    with database.read() as session:
        assert verify_audit(session).is_whole
        assert len(audit_page(session)) == 3
        assert verify_audit(session).n_lines == 3


@POSTGRES_ALONE
@pytest.mark.parametrize("trusted_for_s", [0.0, postgresql.TRUSTED_FOR_S])
def test_a_connection_that_its_server_ended_is_not_taken(
    database: Database, monkeypatch: pytest.MonkeyPatch, trusted_for_s: float
) -> None:
    """Not even a moment after it was used."""
    monkeypatch.setattr(postgresql, "TRUSTED_FOR_S", trusted_for_s)
    ended = text("SELECT pg_terminate_backend(:pid, 5000)")
    own = text("SELECT pg_backend_pid()")
    for _ in range(3):
        with database.read() as session, database.read() as other:
            pid, own_pid = session.scalar(own), other.scalar(own)
            assert pid != own_pid
        with database.read() as session:
            still = session.scalar(own)
            assert session.scalar(ended, {"pid": pid if still == own_pid else own_pid})
        with database.read() as session, database.write() as other:
            assert session.scalar(own) != other.scalar(own)


@POSTGRES_ALONE
def test_a_machine_that_is_gone_is_given_up_within_half_a_minute(
    counted: tuple[Database, Proxy],
) -> None:
    """Without these an answer is waited for without end: no packet says that none comes."""
    with counted[0].read() as session:
        driver = session.connection().connection.driver_connection
        assert driver is not None
        connected = socket.socket(fileno=os.dup(driver.fileno()))
    with connected:
        assert connected.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)
        first_s, every_s, lost_after_ms = (
            connected.getsockopt(socket.IPPROTO_TCP, option)
            for option in (socket.TCP_KEEPIDLE, socket.TCP_KEEPINTVL, socket.TCP_USER_TIMEOUT)
        )
    assert first_s + every_s < 30
    assert lost_after_ms == 30_000


def test_the_time_in_a_statement_is_that_of_the_database(database: Database) -> None:
    with database.write() as session:
        before = database_now(session)
        values = {"at": NOW, "lives_until": NOW, "lanes": [], "missing_splits": []}
        session.execute(insert(WorkerHeartbeat).values(worker_id="one", **values))
        at = session.scalar(select(WorkerHeartbeat.at))
        assert at is not None
        later = session.scalars(select(seconds_from_now(90.5))).one()
        passed_s = session.scalar(select(seconds_since(seconds_from_now(-1.5))))
        after = database_now(session)
        is_now = select(func.count()).where(WorkerHeartbeat.at <= NOW, WorkerHeartbeat.at == at)
        assert session.scalar(is_now) == 1
    assert before <= at <= after
    assert before <= later - timedelta(seconds=90.5) <= after
    assert passed_s == pytest.approx(1.5, abs=0.01)


@POSTGRES_ALONE
def test_a_claim_is_kept_at_once(world: World) -> None:
    with world.database.claim() as session:
        claimed = claim_board(session, Lane.LIVE, 30)
        assert claimed is not None
        with world.database.write() as other:  # or it waits for a lock, until it gives up
            want_board(other, "dev", world.protocol_digest)
    with world.database.read() as session:
        request = session.get_one(BoardRequest, claimed.id)
        assert (request.state, request.fence) == ("leased", claimed.fence)
