"""Dispatch: messages that wake a lane, on a real broker that is killed, frozen and emptied."""

import json
import signal
from collections.abc import Iterator
from typing import Any

import pytest
from sqlalchemy import select

from exceptiondrive_records.db.settings import RecordsSettings
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.work import dispatch
from exceptiondrive_records.work.dispatch import Dispatcher, kinds_due, mark_queued, wake_lanes
from exceptiondrive_records.work.heartbeats import beat
from exceptiondrive_records.work.profiles import ask_for_profile
from exceptiondrive_records.work.tables import BoardRequest, Job, Profile, WorkItem, WorkState
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.jobs import Lane

Broker = Any
World = Any
SETTINGS = RecordsSettings()


@pytest.fixture
def dispatcher(broker: Broker) -> Iterator[Dispatcher]:
    made = Dispatcher(broker.url)
    yield made
    made.close()


def test_a_message_names_its_lane_and_nothing_else(broker: Broker, dispatcher: Dispatcher) -> None:
    assert dispatcher.wake(Lane.LIVE)
    with broker.client() as client:
        message = json.loads(client.lindex("ed:live", 0))
    assert message["headers"]["task"] == "exceptiondrive.wake"
    assert message["headers"]["argsrepr"] == "('live',)"
    assert message["headers"]["ignore_result"] is True


def test_lanes_do_not_hear_each_other(broker: Broker, dispatcher: Dispatcher) -> None:
    assert dispatcher.wake(Lane.RESCORE, at_most=2)
    assert dispatcher.wake(Lane.LIVE)
    assert (broker.waiting("live"), broker.waiting("rescore")) == (1, 2)


def test_no_more_messages_wait_than_were_asked_for(broker: Broker, dispatcher: Dispatcher) -> None:
    for _ in range(5):
        assert dispatcher.wake(Lane.LIVE, at_most=3)
    assert broker.waiting() == 3
    assert dispatcher.wake(Lane.LIVE, at_most=2)
    assert broker.waiting() == 3


def test_a_broker_that_lost_everything_is_told_again_at_once(
    broker: Broker, dispatcher: Dispatcher
) -> None:
    dispatcher.wake(Lane.LIVE)
    with broker.client() as client:
        client.flushall()
    assert dispatcher.wake(Lane.LIVE)
    assert broker.waiting() == 1


def test_a_dead_broker_makes_no_error_and_is_left_alone_for_a_moment(
    broker: Broker, dispatcher: Dispatcher
) -> None:
    broker.kill()
    assert dispatcher.wake(Lane.LIVE) is False
    broker.start()
    assert dispatcher.wake(Lane.LIVE) is False  # still quiet: uploads do not wait for it
    assert broker.waiting() == 0


def test_a_frozen_broker_is_given_up_soon(
    broker: Broker, dispatcher: Dispatcher, monkeypatch: Any
) -> None:
    monkeypatch.setattr(dispatch, "QUIET_AFTER_FAILURE_S", 0.0)
    assert dispatcher.wake(Lane.LIVE)
    broker.process.send_signal(signal.SIGSTOP)
    assert dispatcher.wake(Lane.LIVE, at_most=2) is False
    broker.process.send_signal(signal.SIGCONT)
    assert dispatcher.wake(Lane.LIVE, at_most=2)


def test_a_lane_is_woken_for_what_waits_in_it_and_at_most_once_a_worker(
    world: World, broker: Broker, dispatcher: Dispatcher
) -> None:
    for i in range(30):
        world.submit(f"file {i}")
    assert wake_lanes(world.database, dispatcher, SETTINGS) == 31, "with the board of the phase"
    assert (broker.waiting(), broker.waiting("rescore")) == (1, 0), "no worker is alive yet"
    with world.database.write() as session:
        for number in range(5):
            beat(session, f"worker-{number}")
    wake_lanes(world.database, dispatcher, SETTINGS)
    assert broker.waiting() == 5
    wake_lanes(world.database, dispatcher, SETTINGS)
    assert broker.waiting() == 5


def test_where_nothing_is_to_be_done_nobody_is_woken(
    world: World, broker: Broker, dispatcher: Dispatcher
) -> None:
    world.publish(world.board())
    assert wake_lanes(world.database, dispatcher, SETTINGS) == 0
    accepted = world.submit("file")
    world.claim(accepted.job_id)
    assert wake_lanes(world.database, dispatcher, SETTINGS) == 0, "somebody is at it"
    with world.database.write() as session:
        job = session.get_one(Job, accepted.job_id)
        job.state, job.lease_until = WorkState.HELD, None
    assert wake_lanes(world.database, dispatcher, SETTINGS) == 0, "it waits for its run"
    assert broker.waiting() == 0


def test_a_worker_is_told_which_kinds_of_work_are_due_in_its_lane(world: World) -> None:
    def due(lane: Lane = Lane.LIVE) -> set[type[WorkItem]]:
        with world.database.read() as session:
            return set(kinds_due(session, lane, SETTINGS.max_attempts))

    world.publish(world.board())
    assert due() == set()
    accepted = world.submit("file")
    assert due() == {Job}
    job = world.claim(accepted.job_id)
    assert due() == set(), "somebody is at it"
    assert world.finish(job, 0.5)
    assert due() == {BoardRequest}
    with world.database.write() as session:
        ask_for_profile(session, accepted.submission.id)
    assert due() == {BoardRequest, Profile}
    with world.database.write() as session:
        session.scalars(select(Profile)).one().attempts = SETTINGS.max_attempts
    assert due() == {BoardRequest}, "it had all its attempts"
    assert due(Lane.RESCORE) == set()


def test_a_submission_shows_as_queued_once_a_worker_was_woken_for_it(world: World) -> None:
    accepted, other = world.submit("file"), world.submit("other")
    world.claim(other.job_id)
    with world.database.write() as session:
        assert mark_queued(session) == 1
        assert mark_queued(session) == 0
    with world.database.read() as session:
        statuses = [
            session.get_one(Submission, one.submission.id).status for one in (accepted, other)
        ]
    assert statuses == [SubmissionStatus.QUEUED, SubmissionStatus.SCORING]
