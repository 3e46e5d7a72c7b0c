"""Stored protocols never change: they load, with the same digests, whatever is added later."""

import json
import re
from typing import Any

import pytest

from exceptiondrive_schemas import protocol as module
from exceptiondrive_schemas.base import content_digest
from exceptiondrive_schemas.challenges import CHALLENGES, PLANNING, Challenge
from exceptiondrive_schemas.protocol import (
    GradingSection,
    ProtocolDocument,
    ProtocolError,
    packaged_protocol,
    packaged_protocol_toml,
    parse_protocol,
)
from exceptiondrive_schemas.taxonomy import Task

DIGESTS = {
    "digest": "sha256:a8e2d76169081d535816cf802920c30cf5c66575ecbd094df6d373e6b1c739e5",
    "geometry_digest": "sha256:b472c9a63297efdda823631f5315a79f4e81a2607fd307801a8b31219a276ae6",
    "grading_digest": "sha256:5c20866f8b8e8f4b2e811e4aa4d9fc3e9d1035ebb9a6e98498e274168fb9f7d5",
    "ranking_digest": "sha256:fce30e86d3f8506885eb2c67ce598156aee445d18a20309c3517952a6b19b109",
}
DEFAULTS = r"(?m)^(d_safe_scale|sensitivity_factors|compared_entries) = .*$"


def digests(protocol: ProtocolDocument) -> dict[str, str]:
    return {name: getattr(protocol, name) for name in DIGESTS}


def test_the_digests_of_the_packaged_protocol_stay() -> None:
    assert digests(packaged_protocol()) == DIGESTS


def test_the_first_defaults_stand_in_the_digest_whether_stated_or_not() -> None:
    bare = parse_protocol(re.sub(DEFAULTS, "", packaged_protocol_toml()))
    stated = bare.model_copy(update={"grading": GradingSection(**bare.grading.model_dump())})
    assert bare.digest == stated.digest
    stating = {"d_safe_scale": 1.0, "sensitivity_factors": (), "compared_entries": 0}
    others = {
        name
        for section in (bare.grading, bare.ranking, bare.plausibility, bare.publication)
        for name, field in type(section).model_fields.items()
        if not field.is_required() and name not in stating
    }
    document = json.loads(bare.model_dump_json(by_alias=True))
    for section in document.values():
        for name in others & set(section if isinstance(section, dict) else ()):
            del section[name]
    assert bare.digest == content_digest(document)


class LaterGrading(GradingSection):
    """A section of a later version: with a field more."""

    comfort_m: float = 1.5


class LaterTask(Task):
    """A task of a later version."""

    weather: str | None = None


class LaterProtocol(ProtocolDocument):
    """A protocol of a later version."""

    grading: LaterGrading
    tasks: tuple[LaterTask, ...]
    contact: str = ""


def later(**changes: Any) -> LaterProtocol:
    document = packaged_protocol().model_dump(mode="json", by_alias=True)
    for name, value in changes.items():
        document[name] = {**document[name], **value} if isinstance(value, dict) else value
    return LaterProtocol.model_validate_json(json.dumps(document))


def test_a_field_that_came_later_leaves_every_digest_as_it_is() -> None:
    assert digests(later()) == DIGESTS


def test_a_field_that_came_later_is_digested_where_it_says_something() -> None:
    assert digests(later(contact="ada@example.org"))["digest"] != DIGESTS["digest"]
    graded = digests(later(grading={"comfort_m": 2.0}))
    assert {name for name in DIGESTS if graded[name] != DIGESTS[name]} == {
        "digest",
        "grading_digest",
    }


def test_the_default_itself_says_nothing() -> None:
    assert digests(later(grading={"comfort_m": 1.5})) == DIGESTS


@pytest.fixture
def third_challenge(monkeypatch: pytest.MonkeyPatch) -> Challenge:
    toy = Challenge.model_construct(
        **{**dict(PLANNING), "id": "toy", "is_ordered_by_protocol": False}
    )
    more: dict[Any, Challenge] = {**CHALLENGES, "toy": toy}
    monkeypatch.setattr(module, "CHALLENGES", more)
    return toy


def test_a_protocol_older_than_a_challenge_ranks_it_by_its_primary_metrics(
    third_challenge: Challenge,
) -> None:
    protocol = packaged_protocol()
    assert digests(protocol) == DIGESTS
    order = protocol.ranking.order_of(third_challenge)
    assert [(key.metric, key.order) for key in order] == [
        ("hcc", "descending"),
        ("ur", "ascending"),
    ]


def test_a_challenge_that_every_protocol_orders_may_not_be_left_out() -> None:
    without = re.sub(r"\[\[ranking\.order\.strategy\]\]\n.*\n.*\n", "", packaged_protocol_toml())
    with pytest.raises(ProtocolError, match="order needs exactly the challenges"):
        parse_protocol(without)
