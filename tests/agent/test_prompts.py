import pytest
from jsonschema import Draft202012Validator

from exceptiondrive_agent.questions import (
    DECISION_INSTRUCTIONS,
    decision_schema,
    messages,
    reminder_instructions,
    reminder_schema,
    reminder_text,
)
from exceptiondrive_endpoints.images import CleanImage
from exceptiondrive_schemas.protocol import ProtocolDocument, packaged_protocol
from exceptiondrive_schemas.submission_files import ReminderRecord
from exceptiondrive_schemas.taxonomy import RegionKind, Strategy, Taxonomy

IMAGES = (CleanImage("image/png", b"one"), CleanImage("image/png", b"two"))


@pytest.fixture(scope="module")
def protocol() -> ProtocolDocument:
    return packaged_protocol()


def with_other_secrets(taxonomy: Taxonomy) -> Taxonomy:
    """The same public taxonomy with other acceptable sets, clearances and region kinds."""
    tasks = tuple(
        task.model_copy(
            update={
                "acceptable": (Strategy.A,),
                "d_safe_m": 19.0,
                "region": RegionKind.PHYSICAL
                if task.region is RegionKind.CONFLICT
                else RegionKind.CONFLICT,
            }
        )
        for task in taxonomy.tasks
    )
    return Taxonomy(families=taxonomy.families, tasks=tasks)


def test_the_reminder_agent_is_told_every_task_with_its_hazard_and_family(
    protocol: ProtocolDocument,
) -> None:
    text = reminder_instructions(protocol.taxonomy)
    for task in protocol.tasks:
        assert f"{task.id}, {task.name}: {task.hazard}" in text
    for family in protocol.families:
        assert f"[{family.title}]" in text
    for strategy in Strategy:
        assert f"{strategy.value}: {strategy.action}" in text


def test_acceptable_sets_clearances_and_region_kinds_change_nothing_that_is_told(
    protocol: ProtocolDocument,
) -> None:
    other = with_other_secrets(protocol.taxonomy)
    record = ReminderRecord(hazard_present=True, hazard_type="IC2")
    assert reminder_instructions(other) == reminder_instructions(protocol.taxonomy)
    assert reminder_schema(other) == reminder_schema(protocol.taxonomy)
    assert reminder_text(record, other) == reminder_text(record, protocol.taxonomy)


def test_the_base_instructions_of_the_decision_name_no_task(protocol: ProtocolDocument) -> None:
    assert all(task.name not in DECISION_INSTRUCTIONS for task in protocol.tasks)
    assert all(f"{s.value}: {s.action}" in DECISION_INSTRUCTIONS for s in Strategy)


def test_a_reminder_is_one_more_text_after_identical_instructions_and_images() -> None:
    without = messages(DECISION_INSTRUCTIONS, IMAGES)
    given = messages(DECISION_INSTRUCTIONS, IMAGES, reminder="Risk reminder: ...")
    added = given[1]["content"].pop()
    assert added == {"type": "text", "text": "Risk reminder: ..."}
    assert given == without


def test_images_are_numbered_and_named_by_their_public_views() -> None:
    parts = messages("look", IMAGES, ("front left", "front"))[1]["content"]
    texts = [part["text"] for part in parts if part["type"] == "text"]
    assert texts == ["Image 1 of 2 (front left):", "Image 2 of 2 (front):"]


def test_a_reminder_spells_out_the_hazard_and_the_strategy(protocol: ProtocolDocument) -> None:
    record = ReminderRecord(hazard_type="LB1", recommended_strategy=Strategy.C)
    text = reminder_text(record, protocol.taxonomy)
    assert '"stalled_vehicle: a broken-down vehicle fills the ego lane' in text
    assert '"recommended_strategy": "C: stop"' in text


def test_the_answer_schemas_are_valid_and_closed(protocol: ProtocolDocument) -> None:
    for schema in (reminder_schema(protocol.taxonomy), decision_schema()):
        Draft202012Validator.check_schema(schema)
        assert schema["additionalProperties"] is False
        assert schema["required"] == list(schema["properties"])


def test_the_reminder_schema_takes_task_ids_of_the_taxonomy_and_null_alone(
    protocol: ProtocolDocument, record: dict[str, object]
) -> None:
    validator = Draft202012Validator(reminder_schema(protocol.taxonomy))
    assert validator.is_valid(record)
    assert validator.is_valid(record | {"hazard_type": None})
    assert not validator.is_valid(record | {"hazard_type": "stalled_vehicle"})
    assert not validator.is_valid(record | {"recommended_strategy": None})
