import json
from pathlib import Path

import pytest

from exceptiondrive_agent.questions import read_reminder
from exceptiondrive_endpoints.endpoint import Completion, read_answer
from exceptiondrive_endpoints.errors import NoAnswerError
from exceptiondrive_schemas.protocol import packaged_protocol

TAXONOMY = packaged_protocol().taxonomy
RECORDED = sorted((Path(__file__).parent / "recorded").iterdir())
GOOD = [path for path in RECORDED if path.name.startswith("good-")]
BAD = [path for path in RECORDED if not path.name.startswith("good-")]


@pytest.mark.parametrize("path", GOOD, ids=lambda path: path.stem)
def test_a_good_response_gives_the_record(path: Path) -> None:
    record = read_reminder(read_answer(Completion, path.read_bytes()).text, TAXONOMY)
    assert record.hazard_type == "LB1"
    assert record.recommended_strategy == "C"


@pytest.mark.parametrize("path", BAD, ids=lambda path: path.stem)
def test_a_bad_response_gives_the_reason_that_its_file_is_named_by(path: Path) -> None:
    with pytest.raises(NoAnswerError) as caught:
        read_reminder(read_answer(Completion, path.read_bytes()).text, TAXONOMY)
    assert caught.value.reason == path.name.partition("-")[0].removesuffix(".json")


def test_tokens_are_none_where_the_endpoint_counts_none() -> None:
    counted, uncounted = (
        read_answer(Completion, (Path(__file__).parent / "recorded" / name).read_bytes())
        for name in ("good-vllm.json", "good-ollama-fenced-no-usage.json")
    )
    assert counted.usage is not None
    assert (counted.usage.prompt_tokens, counted.usage.completion_tokens) == (2514, 97)
    assert uncounted.usage is None


def test_an_answer_counts_where_its_tokens_are_null() -> None:
    body = {"choices": [{"message": {"content": "C"}}], "usage": {"prompt_tokens": None}}
    completion = read_answer(Completion, json.dumps(body).encode())
    assert completion.text == "C"
    assert completion.usage is not None
    assert completion.usage.prompt_tokens == 0


def test_more_than_one_choice_is_no_answer() -> None:
    choice = {"message": {"content": "C"}, "finish_reason": "stop"}
    completion = read_answer(Completion, json.dumps({"choices": [choice, choice]}).encode())
    with pytest.raises(NoAnswerError, match="one choice, got 2"):
        _ = completion.text
