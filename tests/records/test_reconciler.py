"""The reconciler: what is due is rung, what is exhausted is given up, by one leader."""

import threading
from datetime import timedelta
from typing import Any

from sqlalchemy import update

from exceptiondrive_records.audit.log import count_audit_lines
from exceptiondrive_records.db.base import JobState
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.db.settings import RecordsSettings
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.work.doorbell import Doorbell
from exceptiondrive_records.work.heartbeats import beat
from exceptiondrive_records.work.reconciler import (
    Pass,
    give_up_lead,
    reconcile_once,
    run_reconciler,
    take_lead,
)
from exceptiondrive_records.work.ringing import ring_job
from exceptiondrive_records.work.tables import BoardRequest, Job, Leader
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_schemas.submission import SubmissionStatus

World = Any
Broker = Any
SETTINGS = RecordsSettings(window=3, max_attempts=2)


def messages(broker: Broker, name: str = "exceptiondrive.score") -> int:
    with broker.client() as client:
        return sum(name.encode() in message for message in client.lrange("ed:live", 0, -1))


def hours_pass(world: World) -> None:
    with world.database.write() as session:
        for job in session.query(Job):
            job.lease_until = job.lease_until and job.lease_until - timedelta(hours=2)
            job.rung_at = job.rung_at and job.rung_at - timedelta(hours=2)
        for request in session.query(BoardRequest):
            request.rung_at = request.rung_at and request.rung_at - timedelta(hours=2)


def test_a_new_submission_is_rung_once_and_shows_as_queued(world: World, broker: Broker) -> None:
    accepted = world.submit("file")
    bell = Doorbell(broker.url)
    assert ring_job(world.database, bell, accepted.job_id, SETTINGS)
    assert reconcile_once(world.database, bell, SETTINGS).rung_jobs == 0
    assert messages(broker) == 1
    with world.database.read() as session:
        assert session.get(Submission, accepted.submission.id).status is SubmissionStatus.QUEUED


def test_what_was_accepted_while_the_broker_was_down_is_rung_later(
    world: World, broker: Broker
) -> None:
    bell = Doorbell(broker.url)
    broker.kill()
    accepted = world.submit("file")
    assert ring_job(world.database, bell, accepted.job_id, SETTINGS) is False
    with world.database.read() as session:
        assert session.get(Job, accepted.job_id).rung_at is None
    broker.start()
    assert reconcile_once(world.database, Doorbell(broker.url), SETTINGS).rung_jobs == 1
    assert messages(broker) == 1


def test_at_most_a_window_of_messages_is_outstanding(world: World, broker: Broker) -> None:
    jobs = [world.submit(f"file {i}").job_id for i in range(7)]
    bell = Doorbell(broker.url)
    assert reconcile_once(world.database, bell, SETTINGS).rung_jobs == 3
    assert reconcile_once(world.database, bell, SETTINGS).rung_jobs == 0
    assert ring_job(world.database, bell, jobs[6], SETTINGS) is False
    world.claim(jobs[0])
    assert reconcile_once(world.database, bell, SETTINGS).rung_jobs == 1
    assert messages(broker) == 4


def test_the_window_grows_with_the_live_slots(world: World, broker: Broker) -> None:
    for i in range(30):
        world.submit(f"file {i}")
    with world.database.write() as session:
        beat(session, "worker-1", (Lane.LIVE,), slots=5)
    settings = RecordsSettings()
    assert reconcile_once(world.database, Doorbell(broker.url), settings).rung_jobs == 5 + 2


def test_lost_messages_are_sent_again_with_growing_pauses(world: World, broker: Broker) -> None:
    world.submit("file")
    bell = Doorbell(broker.url)
    reconcile_once(world.database, bell, SETTINGS)
    with broker.client() as client:
        client.flushall()
    assert reconcile_once(world.database, bell, SETTINGS).rung_jobs == 0  # too soon
    hours_pass(world)
    assert reconcile_once(world.database, bell, SETTINGS).rung_jobs == 1
    with world.database.read() as session:
        assert session.query(Job).one().rings == 2


def test_lost_messages_are_sent_again_though_the_window_has_shrunk(
    world: World, broker: Broker
) -> None:
    for i in range(5):
        world.submit(f"file {i}")
    bell = Doorbell(broker.url)
    wide, narrow = RecordsSettings(window=5), RecordsSettings(window=2)
    assert reconcile_once(world.database, bell, wide).rung_jobs == 5
    hours_pass(world)  # the workers are gone, and so is what was rung
    assert reconcile_once(world.database, bell, narrow).rung_jobs == 5


def test_an_expired_lease_is_rung_again(world: World, broker: Broker) -> None:
    world.claim(world.submit("file").job_id)
    bell = Doorbell(broker.url)
    assert reconcile_once(world.database, bell, SETTINGS).rung_jobs == 0
    hours_pass(world)
    assert reconcile_once(world.database, bell, SETTINGS).rung_jobs == 1


def test_a_job_without_attempts_left_is_given_up_and_the_team_is_told(
    world: World, broker: Broker
) -> None:
    accepted = world.submit("poison")
    bell = Doorbell(broker.url)
    for _ in range(SETTINGS.max_attempts):
        late = world.claim(accepted.job_id)
        hours_pass(world)
    assert reconcile_once(world.database, bell, SETTINGS).dead_jobs == 1
    assert reconcile_once(world.database, bell, SETTINGS).dead_jobs == 0
    assert world.finish(late).value == "lease_lost"
    with world.database.read() as session:
        submission = session.get(Submission, accepted.submission.id)
        assert submission.status is SubmissionStatus.FAILED
        assert submission.failure_code == "attempts_exhausted"
        assert session.get(Job, accepted.job_id).state is JobState.DEAD
        assert count_audit_lines(session, "scoring failed") == 1


def test_a_wanted_board_is_rung_once_until_a_worker_comes(world: World, broker: Broker) -> None:
    bell = Doorbell(broker.url)
    assert reconcile_once(world.database, bell, SETTINGS) == Pass(rung_boards=1)
    assert reconcile_once(world.database, bell, SETTINGS) == Pass()
    world.score(world.submit("file").job_id)
    assert reconcile_once(world.database, bell, SETTINGS) == Pass(), "who comes builds for both"
    hours_pass(world)
    assert reconcile_once(world.database, bell, SETTINGS) == Pass(rung_boards=1), "it was lost"
    with world.database.write() as session:
        session.execute(update(BoardRequest).values(built=BoardRequest.wanted, rung_at=None))
    assert reconcile_once(world.database, bell, SETTINGS) == Pass()
    assert messages(broker, "exceptiondrive.build_board") == 2


def test_one_leads_until_its_lease_ends(database: Database) -> None:
    def leads(holder: str) -> bool:
        with database.write() as session:
            return take_lead(session, "reconciler", holder, 10)

    assert leads("a")
    assert not leads("b")
    assert leads("a")
    with database.write() as session:
        lease_until = session.get_one(Leader, "reconciler").lease_until
        session.execute(update(Leader).values(lease_until=lease_until - timedelta(hours=1)))
    assert leads("b")
    assert not leads("a")
    with database.write() as session:
        give_up_lead(session, "reconciler", "a")  # not the leader: changes nothing
        give_up_lead(session, "reconciler", "b")
    assert leads("a")


def test_two_reconcilers_ring_no_more_than_one(world: World, broker: Broker) -> None:
    for i in range(5):
        world.submit(f"file {i}")
    stop = threading.Event()
    settings = RecordsSettings(window=3, reconcile_every_s=0.02)
    threads = [
        threading.Thread(
            target=run_reconciler, args=(world.database, Doorbell(broker.url), settings, stop)
        )
        for _ in range(2)
    ]
    for thread in threads:
        thread.start()
    waiter = threading.Event()
    for _ in range(500):
        if messages(broker) >= 3:
            break
        waiter.wait(0.02)
    waiter.wait(0.2)  # some more passes
    stop.set()
    for thread in threads:
        thread.join()
    assert messages(broker) == 3
    with world.database.read() as session:
        assert session.query(Leader).count() == 0  # both gave up in good order
