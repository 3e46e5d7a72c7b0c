"""A message that wakes a lane is told from junk before Celery sees it."""

import json

import pytest
from tests.chaos.junk import JUNK, MARK, message

from exceptiondrive_schemas.jobs import JobName
from exceptiondrive_worker.app import MAX_MESSAGE_BYTES, why_junk


@pytest.mark.parametrize("name", JobName)
def test_a_message_of_ours_passes(name: JobName) -> None:
    more = {"callbacks": None, "errbacks": None, "chain": None, "chord": None}
    body: object = (["live"], {}, more)
    assert why_junk(message(body=body, headers={"task": name.value})) is None


def test_a_message_that_was_given_back_passes_again() -> None:
    document = json.loads(message())
    document["headers"]["redelivered"] = True
    document["properties"]["delivery_info"]["redelivered"] = True
    assert why_junk(json.dumps(document).encode()) is None


def test_fields_of_a_later_celery_are_no_fault() -> None:
    assert why_junk(message(headers={"new": 1}, properties={"new": [1]}, new={"x": 1})) is None


@pytest.mark.parametrize("kind", JUNK)
def test_junk_is_named_without_its_content(kind: str) -> None:
    reason = why_junk(JUNK[kind])
    assert reason is not None
    assert MARK not in reason


def test_size_alone_makes_junk() -> None:
    room = MAX_MESSAGE_BYTES - len(message(padding=""))
    assert why_junk(message(padding="x" * room)) is None
    assert why_junk(message(padding="x" * (room + 1))) == "it has more than 16384 bytes"
