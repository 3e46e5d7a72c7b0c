"""The resolved sets in the protocol: stored, digested, and never at odds with the caution ranks."""

import pytest

from exceptiondrive_schemas.board import BoardEntry
from exceptiondrive_schemas.challenges import STRATEGY
from exceptiondrive_schemas.protocol import (
    ProtocolDocument,
    ProtocolError,
    packaged_protocol_toml,
    parse_protocol,
)
from exceptiondrive_schemas.python310 import tomllib
from exceptiondrive_schemas.reported import reported_entries
from exceptiondrive_schemas.score_sheet import ReminderEffect
from exceptiondrive_schemas.taxonomy import Strategy

SWAPPED = ("E = 2, D = 3", "E = 3, D = 2")


@pytest.fixture
def protocol() -> ProtocolDocument:
    return parse_protocol(packaged_protocol_toml())


def test_every_task_of_the_document_names_the_answers_that_warn_too_little() -> None:
    tasks = {task["id"]: task for task in tomllib.loads(packaged_protocol_toml())["tasks"]}
    assert len(tasks) == 21
    assert tasks["SE1"]["under_warning"] == ["A", "B", "E"]
    assert tasks["LB1"]["under_warning"] == ["A", "B", "D", "E"]
    assert tasks["BG1"]["under_warning"] == ["A"]
    assert tasks["RS1"]["under_warning"] == ["A", "B"]


def test_acceptable_answers_never_warn_too_little(protocol: ProtocolDocument) -> None:
    for task in protocol.tasks:
        assert not set(task.acceptable) & set(task.under_warning)


def test_another_order_of_caution_is_refused_until_the_sets_follow_it() -> None:
    with pytest.raises(ProtocolError) as refused:
        parse_protocol(packaged_protocol_toml().replace(*SWAPPED))
    assert "under_warning of task SE1 must be [A, B], not [A, B, E]" in str(refused.value)
    assert "under_warning of task RS1 must be [A, B, D], not [A, B]" in str(refused.value)
    assert "task LB1" not in str(refused.value)


def test_a_hand_written_set_that_does_not_follow_is_refused() -> None:
    wrong = packaged_protocol_toml().replace(
        'under_warning = ["A", "B", "E"]', 'under_warning = ["A", "B"]', 1
    )
    with pytest.raises(ProtocolError, match=r"task SE1 must be \[A, B, E\], not \[A, B\]"):
        parse_protocol(wrong)


def test_strategies_of_the_same_caution_do_not_warn_less_than_each_other(
    protocol: ProtocolDocument,
) -> None:
    flat = protocol.grading.model_copy(update={"caution": dict.fromkeys("ABCDE", 1)})
    assert flat.under_warning((Strategy.C,)) == ()


def test_the_sets_are_part_of_the_grading_digest_and_of_no_other(
    protocol: ProtocolDocument,
) -> None:
    tasks = tuple(task.model_copy(update={"under_warning": ()}) for task in protocol.tasks)
    other = protocol.model_copy(update={"tasks": tasks})
    assert other.grading_digest != protocol.grading_digest
    assert other.geometry_digest == protocol.geometry_digest
    assert other.ranking_digest == protocol.ranking_digest


def test_an_entry_without_a_linked_one_says_nothing_about_an_effect() -> None:
    entry = reported_entries(STRATEGY.id, "macro_family")[0]
    assert "reminder_effect" not in entry.model_dump(mode="json")
    effect = ReminderEffect(without="abc", without_method="Plain", differences={})
    linked = entry.model_copy(update={"reminder_effect": effect})
    assert BoardEntry.model_validate_json(linked.model_dump_json()) == linked
