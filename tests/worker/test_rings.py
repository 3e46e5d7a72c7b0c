"""A ring is told from junk before Celery sees it."""

import json

import pytest
from tests.chaos.junk import JUNK, MARK, ring

from exceptiondrive_schemas.jobs import JobName
from exceptiondrive_worker.rings import MAX_RING_BYTES, why_no_ring


@pytest.mark.parametrize("name", JobName)
@pytest.mark.parametrize("ids", [["a"], ["dev", "sha256:1", "sha256:2"]], ids=len)
def test_a_ring_passes(name: JobName, ids: list[str]) -> None:
    more = {"callbacks": None, "errbacks": None, "chain": None, "chord": None}
    assert why_no_ring(ring(body=(ids, {}, more), headers={"task": name.value})) is None


def test_a_ring_that_was_given_back_passes_again() -> None:
    document = json.loads(ring())
    document["headers"]["redelivered"] = True
    document["properties"]["delivery_info"]["redelivered"] = True
    assert why_no_ring(json.dumps(document).encode()) is None


def test_fields_of_a_later_celery_are_no_fault() -> None:
    assert why_no_ring(ring(headers={"new": 1}, properties={"new": [1]}, new={"x": 1})) is None


@pytest.mark.parametrize("kind", JUNK)
def test_junk_is_named_without_its_content(kind: str) -> None:
    reason = why_no_ring(JUNK[kind])
    assert reason is not None
    assert MARK not in reason


def test_size_alone_makes_junk() -> None:
    room = MAX_RING_BYTES - len(ring(padding=""))
    assert why_no_ring(ring(padding="x" * room)) is None
    assert why_no_ring(ring(padding="x" * (room + 1))) == "it has more than 16384 bytes"
