"""The doorbell, on a real broker that is killed, frozen and emptied."""

import json
import signal
from typing import Any

from exceptiondrive_records.work import doorbell as doorbell_module
from exceptiondrive_records.work.doorbell import Doorbell
from exceptiondrive_schemas.jobs import Lane

Broker = Any


def waiting(broker: Broker, lane: str = "live") -> int:
    with broker.client() as client:
        return int(client.llen(f"ed:{lane}"))


def test_a_ring_carries_ids_and_nothing_else(broker: Broker) -> None:
    assert Doorbell(broker.url).ring_score("job-1")
    with broker.client() as client:
        message = json.loads(client.lindex("ed:live", 0))
    assert message["headers"]["task"] == "exceptiondrive.score"
    assert message["headers"]["argsrepr"] == "('job-1',)"
    assert message["headers"]["ignore_result"] is True


def test_lanes_do_not_hear_each_other(broker: Broker) -> None:
    bell = Doorbell(broker.url)
    assert bell.ring_score("job-1", Lane.RESCORE)
    assert bell.ring_board("dev", "sha256:p")
    assert (waiting(broker, "live"), waiting(broker, "rescore")) == (1, 1)


def test_a_broker_that_lost_everything_is_rung_again_at_once(broker: Broker) -> None:
    bell = Doorbell(broker.url)
    bell.ring_score("job-1")
    with broker.client() as client:
        client.flushall()
    assert bell.ring_score("job-2")
    assert waiting(broker) == 1


def test_a_dead_broker_makes_no_error_and_is_left_alone_for_a_moment(broker: Broker) -> None:
    bell = Doorbell(broker.url)
    broker.kill()
    assert bell.ring_score("job-1") is False
    broker.start()
    assert bell.ring_score("job-2") is False  # still quiet: uploads do not wait for it
    assert waiting(broker) == 0


def test_a_frozen_broker_is_given_up_soon(broker: Broker, monkeypatch: Any) -> None:
    monkeypatch.setattr(doorbell_module, "QUIET_AFTER_FAILURE_S", 0.0)
    bell = Doorbell(broker.url)
    assert bell.ring_score("job-1")
    broker.process.send_signal(signal.SIGSTOP)
    assert bell.ring_score("job-2") is False
    broker.process.send_signal(signal.SIGCONT)
    assert bell.ring_score("job-3")
