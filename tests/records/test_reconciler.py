"""The reconciler: lanes with work are woken, what is exhausted is given up, by one leader."""

import threading
from datetime import timedelta
from typing import Any

import pytest
from sqlalchemy import select, text, update
from sqlalchemy.exc import OperationalError, ProgrammingError
from sqlalchemy.orm import Session
from structlog.testing import capture_logs
from tests.support.databases import POSTGRES_ALONE
from tests.support.records import count_audit_lines
from tests.support.work import let_time_pass

from exceptiondrive_records.db.database import Database, sentence_of
from exceptiondrive_records.db.settings import RecordsSettings
from exceptiondrive_records.notifications.channels import NoticeSettings
from exceptiondrive_records.notifications.outbox import run_outbox
from exceptiondrive_records.operations.overview import worker_signs
from exceptiondrive_records.operations.reconciler import Pass, reconcile_once, run_reconciler
from exceptiondrive_records.operations.troubles import troubles
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.work.dispatch import Dispatcher
from exceptiondrive_records.work.heartbeats import beat, live_workers
from exceptiondrive_records.work.jobs import claim_job
from exceptiondrive_records.work.lease import claim_oldest, give_up_lead, take_lead
from exceptiondrive_records.work.profiles import ask_for_profile, profiles_coming
from exceptiondrive_records.work.tables import (
    Job,
    Leader,
    Profile,
    WorkerHeartbeat,
    WorkItem,
    WorkState,
)
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_server.web.metrics import RequestMetrics, exposition

World = Any
Broker = Any
SETTINGS = RecordsSettings(max_attempts=2)


class OneLook(threading.Event):
    def wait(self, timeout: float | None = None) -> bool:
        self.set()
        return True


def hours_pass(world: World) -> None:
    with world.database.write() as session:
        let_time_pass(session, timedelta(hours=2))


def test_a_new_submission_wakes_a_worker_and_shows_as_queued(world: World, broker: Broker) -> None:
    world.publish(world.board())
    accepted = world.submit("file")
    dispatcher = Dispatcher(broker.url)
    assert reconcile_once(world.database, dispatcher, SETTINGS) == Pass(woken_for=1)
    assert broker.waiting() == 1
    with world.database.read() as session:
        assert session.get(Submission, accepted.submission.id).status is SubmissionStatus.QUEUED


def test_what_was_accepted_while_the_broker_was_down_wakes_a_worker_later(
    world: World, broker: Broker
) -> None:
    world.publish(world.board())
    dispatcher = Dispatcher(broker.url)
    broker.kill()
    accepted = world.submit("file")
    assert reconcile_once(world.database, dispatcher, SETTINGS) == Pass()
    with world.database.read() as session:
        assert session.get(Submission, accepted.submission.id).status is SubmissionStatus.RECEIVED
    broker.start()
    assert reconcile_once(world.database, Dispatcher(broker.url), SETTINGS).woken_for == 1
    assert broker.waiting() == 1


def test_lost_messages_are_sent_again_in_the_next_pass(world: World, broker: Broker) -> None:
    world.submit("file")
    dispatcher = Dispatcher(broker.url)
    reconcile_once(world.database, dispatcher, SETTINGS)
    with broker.client() as client:
        client.flushall()
    reconcile_once(world.database, dispatcher, SETTINGS)
    assert broker.waiting() == 1


def test_however_often_it_passes_no_more_messages_wait_than_there_are_workers(
    world: World, broker: Broker
) -> None:
    for i in range(7):
        world.submit(f"file {i}")
    with world.database.write() as session:
        for number in range(3):
            beat(session, f"worker-{number}")
    dispatcher = Dispatcher(broker.url)
    for _ in range(5):
        reconcile_once(world.database, dispatcher, SETTINGS)
    assert broker.waiting() == 3


def test_an_expired_lease_wakes_a_worker(world: World, broker: Broker) -> None:
    world.publish(world.board())
    world.claim(world.submit("file").job_id)
    dispatcher = Dispatcher(broker.url)
    assert reconcile_once(world.database, dispatcher, SETTINGS).woken_for == 0
    hours_pass(world)
    assert reconcile_once(world.database, dispatcher, SETTINGS).woken_for == 1


def test_a_job_without_attempts_left_is_given_up_and_the_team_is_told(
    world: World, broker: Broker
) -> None:
    world.publish(world.board())
    accepted = world.submit("poison")
    dispatcher = Dispatcher(broker.url)
    for _ in range(SETTINGS.max_attempts):
        late = world.claim(accepted.job_id)
        hours_pass(world)
    assert reconcile_once(world.database, dispatcher, SETTINGS) == Pass(dead_jobs=1)
    assert reconcile_once(world.database, dispatcher, SETTINGS) == Pass()
    assert not world.finish(late)
    with world.database.read() as session:
        submission = session.get(Submission, accepted.submission.id)
        assert submission.status is SubmissionStatus.FAILED
        assert submission.failure_code == "attempts_exhausted"
        assert session.get(Job, accepted.job_id).state is WorkState.DEAD
        assert count_audit_lines(session, "scoring failed") == 1


def test_a_file_that_ends_whoever_looks_at_it_is_looked_at_no_more(
    world: World, broker: Broker
) -> None:
    world.publish(world.board())
    accepted = world.submit("poison")
    world.score(accepted.job_id)
    key = accepted.submission.id
    with world.database.write() as session:
        ask_for_profile(session, key)
    dispatcher = Dispatcher(broker.url)
    for _ in range(SETTINGS.max_attempts):
        reconcile_once(world.database, dispatcher, SETTINGS)
        with world.database.write() as session:
            assert claim_oldest(session, Profile, 60, SETTINGS.max_attempts) is not None
            assert profiles_coming(session, [key]) == {key}
        hours_pass(world)
    reconcile_once(world.database, dispatcher, SETTINGS)
    with world.database.write() as session:
        assert claim_oldest(session, Profile, 60, SETTINGS.max_attempts) is None
        assert profiles_coming(session, [key]) == set(), "its team waits for nothing"


def test_a_wanted_board_wakes_a_worker_until_it_is_built(world: World, broker: Broker) -> None:
    dispatcher = Dispatcher(broker.url)
    assert reconcile_once(world.database, dispatcher, SETTINGS) == Pass(woken_for=1)
    world.scored("file")
    assert reconcile_once(world.database, dispatcher, SETTINGS) == Pass(woken_for=1)
    assert broker.waiting() == 1, "who comes builds for both"
    world.publish(world.board())
    assert reconcile_once(world.database, dispatcher, SETTINGS) == Pass()


def test_one_leads_until_its_lease_ends(database: Database) -> None:
    def leads(holder: str) -> bool:
        with database.write() as session:
            return take_lead(session, "reconciler", holder, 10)

    assert leads("a")
    assert not leads("b")
    assert leads("a")
    with database.write() as session:
        lease_until = session.query(Leader).one().lease_until
        assert lease_until is not None
        session.execute(update(Leader).values(lease_until=lease_until - timedelta(hours=1)))
    assert leads("b")
    assert not leads("a")
    with database.write() as session:
        give_up_lead(session, "reconciler", "a")  # not the leader: changes nothing
        give_up_lead(session, "reconciler", "b")
    assert leads("a")


def test_a_lead_that_a_clock_ahead_gave_is_taken_over(database: Database) -> None:
    with database.write() as session:
        assert take_lead(session, "reconciler", "a", 10)
        of_tomorrow(session)
        assert "no_reconciler" in [one.code for one in troubles(session)]
        assert take_lead(session, "reconciler", "b", 10)
        assert not take_lead(session, "reconciler", "a", 10)
        assert "no_reconciler" not in [one.code for one in troubles(session)]


def test_work_and_signs_of_life_of_a_clock_that_was_set_back_hold_no_longer(world: World) -> None:
    world.submit("file")
    with world.database.write() as session:
        claimed = claim_job(session, Lane.LIVE, 120, 2)
        assert claimed is not None
        beat(session, "gone")
    with world.database.write() as session:
        assert live_workers(session) == 1
        of_tomorrow(session)
    with world.database.write() as session:
        assert live_workers(session) == 0
        assert list(worker_signs(session)) == []
        again = claim_job(session, Lane.LIVE, 120, 2)
        assert again is not None
        assert (again.id, again.fence) == (claimed.id, claimed.fence + 1)
    told = exposition(RequestMetrics(), world.database).decode()
    assert "exceptiondrive_worker_heartbeat_age_seconds{" not in told


def of_tomorrow(session: Session) -> None:
    """The clock was a day ahead, and has been set back."""
    for row in (*session.scalars(select(WorkItem)), *session.scalars(select(WorkerHeartbeat))):
        for name in ("leased_at", "lease_until", "at", "lives_until"):
            then = getattr(row, name, None)
            if then is not None:
                setattr(row, name, then + timedelta(days=1))
    session.flush()


def test_the_log_says_why_the_database_does_not_answer(broker: Broker) -> None:
    away = Database("postgresql+psycopg://nobody@127.0.0.1:1/none")
    with capture_logs() as logs, pytest.raises(OperationalError):  # it cannot give up the lead
        run_reconciler(away, Dispatcher(broker.url), SETTINGS, OneLook())
    away.dispose()
    (line,) = [line for line in logs if line["event"] == "the database did not answer"]
    assert "Connection refused" in line["reason"]


def test_the_sender_of_messages_says_why_it_sends_none() -> None:
    away = Database("postgresql+psycopg://nobody@127.0.0.1:1/none")
    with capture_logs() as logs:
        run_outbox(away, NoticeSettings(), OneLook())
    away.dispose()
    (line,) = logs
    assert line["event"] == "no message is sent"
    assert "Connection refused" in line["reason"]


@POSTGRES_ALONE
def test_where_a_table_is_missing_it_ends_and_says_so(world: World, broker: Broker) -> None:
    with world.database.write() as session:
        session.execute(text("ALTER TABLE rescoring_runs RENAME TO gone"))
    with pytest.raises(ProgrammingError) as found:
        run_reconciler(world.database, Dispatcher(broker.url), SETTINGS, OneLook())
    assert "nothing is set up in this database yet" in sentence_of(found.value)


def test_two_reconcilers_wake_no_more_than_one(world: World, broker: Broker) -> None:
    for i in range(5):
        world.submit(f"file {i}")
    with world.database.write() as session:
        for number in range(3):
            beat(session, f"worker-{number}")
    stop = threading.Event()
    settings = RecordsSettings(reconcile_every_s=0.02)
    threads = [
        threading.Thread(
            target=run_reconciler, args=(world.database, Dispatcher(broker.url), settings, stop)
        )
        for _ in range(2)
    ]
    for thread in threads:
        thread.start()
    waiter = threading.Event()
    for _ in range(500):
        if broker.waiting() >= 3:
            break
        waiter.wait(0.02)
    waiter.wait(0.2)  # some more passes
    stop.set()
    for thread in threads:
        thread.join()
    assert broker.waiting() == 3
    with world.database.read() as session:
        assert session.query(Leader).count() == 0  # both gave up in good order
