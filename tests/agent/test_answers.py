import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from exceptiondrive_agent.questions import read_reminder, read_strategy
from exceptiondrive_endpoints.answers import json_object
from exceptiondrive_endpoints.errors import NoAnswerError, Reason
from exceptiondrive_schemas.protocol import packaged_protocol
from exceptiondrive_schemas.taxonomy import Strategy

TAXONOMY = packaged_protocol().taxonomy


def reason_of(text: str) -> Reason:
    with pytest.raises(NoAnswerError) as caught:
        read_strategy(text)
    assert caught.value.raw == text
    return caught.value.reason


@pytest.mark.parametrize(
    "text",
    [
        '{"strategy": "C"}',
        '  {"strategy":"C"}\n',
        '```json\n{"strategy": "C"}\n```',
        '```\n{"strategy": "C"}\n```\nThat is my answer.',
        'The lane is blocked, so: {"strategy": "C"}',
        '<think>{"strategy": "A"}? No.</think>{"strategy": "C"}',
        "C",
        " C.\n",
        "(C)",
        "**C**",
        '"C"',
    ],
)
def test_one_clear_strategy_is_read(text: str) -> None:
    assert read_strategy(text) is Strategy.C


@pytest.mark.parametrize(
    "text",
    [
        "",
        "c",
        "F",
        "C or D",
        "Stop",
        "A vehicle stands in the lane. C",
        '{"strategy": "C"} or {"strategy": "D"}',
        '{"strategy": "C"}{"strategy": "C"}',
        '{"strategy": "C", "strategy": "A"}',
        '```json\n{"strategy": "C"}\n```\n```json\n{"strategy": "A"}\n```',
        '{"strategy": "C"',
        '{"strategy": NaN}',
        '<think>it is {"strategy": "C"}',
        '["C"]',
        "C?",
        "!C",
        "[" * 100_000,
        '{"strategy": ' * 100_000,
    ],
)
def test_what_is_no_single_json_object_is_no_answer(text: str) -> None:
    assert reason_of(text) is Reason.NOT_JSON


@pytest.mark.parametrize(
    "text",
    [
        "{}",
        '{"strategy": null}',
        '{"strategy": "stop"}',
        '{"strategy": "c"}',
        '{"strategy": ["C"]}',
        '{"strategy": {"A": 1}}',
        '{"answer": "C"}',
        '{"strategy": "C", "reason": "blocked"}',
    ],
)
def test_json_of_another_form_is_no_answer(text: str) -> None:
    assert reason_of(text) is Reason.WRONG_SCHEMA


def test_a_reminder_record_is_read_whole(record: dict[str, object]) -> None:
    read = read_reminder(json.dumps(record), TAXONOMY)
    assert read.model_dump(mode="json") == record


def test_a_scene_without_hazard_is_a_valid_record(record: dict[str, object]) -> None:
    calm = record | {
        "hazard_present": False,
        "hazard_type": None,
        "relative_location": None,
        "risk_level": "none",
        "evidence": None,
        "safety_constraint": None,
        "recommended_strategy": "A",
    }
    assert read_reminder(json.dumps(calm), TAXONOMY).hazard_present is False


@pytest.mark.parametrize("key", ["hazard_present", "evidence", "recommended_strategy"])
def test_a_record_without_one_of_its_keys_is_no_answer(record: dict[str, object], key: str) -> None:
    del record[key]
    with pytest.raises(NoAnswerError, match=f"wrong_schema: missing: {key}"):
        read_reminder(json.dumps(record), TAXONOMY)


@pytest.mark.parametrize("text", ["a\x00b", "a\x1b[31mb", "a\ud800b"])
def test_a_text_that_cannot_be_kept_or_shown_is_no_answer(
    record: dict[str, object], text: str
) -> None:
    with pytest.raises(NoAnswerError, match="wrong_schema"):
        read_reminder(json.dumps(record | {"evidence": text}), TAXONOMY)


@given(st.text(max_size=200))
def test_any_text_gives_an_answer_that_stands_in_it_or_a_reason(text: str) -> None:
    try:
        answer = read_strategy(text).value
    except NoAnswerError as error:
        answer = error.raw or ""
    assert answer in text


@pytest.mark.parametrize("text", ["<think>", "a </think> b", "```json\n{}\n```"])
def test_what_stands_inside_a_text_of_the_answer_is_text(text: str) -> None:
    assert json_object(json.dumps({"evidence": text})) == {"evidence": text}


@given(st.dictionaries(st.text(max_size=9), st.none() | st.booleans() | st.text(), max_size=4))
def test_every_json_object_is_read_back_as_it_is(document: dict[str, object]) -> None:
    assert json_object(json.dumps(document)) == document
