"""`exceptiondrive remind`, end to end against a real HTTP server."""

import json
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from tests.agent.bench import Bench, shade_of

from exceptiondrive_schemas.submission_files import ReminderRecord

if TYPE_CHECKING:
    from tests.support.chat_endpoint import ChatEndpoint, Seen

FOLDER = Path(__file__).parent / "recorded"
RECORDED = {
    0: ("good-vllm.json", None),
    1: ("good-ollama-fenced-no-usage.json", None),
    2: ("not_json-prose.json", "not_json"),
    3: ("truncated-length.json", "truncated"),
    4: ("refusal-openai.json", "refusal"),
    5: ("wrong_schema-strategy-word.json", "wrong_schema"),
    6: ("unknown_hazard_type-name.json", "unknown_hazard_type"),
    7: ("bad_response-html.json", "bad_response"),
    8: ("filtered-azure.json", "filtered"),
    9: ("empty.json", "empty"),
}


def test_every_sample_gets_a_validated_record_or_null_with_its_reason(
    bench: Bench, endpoint: "ChatEndpoint"
) -> None:
    samples = bench.add_samples(len(RECORDED))
    endpoint.answer = lambda seen: endpoint.recorded(FOLDER / RECORDED[shade_of(seen)][0])
    report = bench.report("remind", "--price-in", "2", "--price-out", "10")
    journal = bench.journal()
    for number, sample_id in enumerate(samples):
        name, reason = RECORDED[number]
        line = journal[sample_id]
        assert line.get("reason") == reason, name
        assert ("reminder" in line) == (reason is None), name
        if reason is None:
            ReminderRecord.model_validate_json(json.dumps(line["reminder"]))
    assert (report["asked"], report["done"], report["requests"]) == (10, 2, 10)
    assert report["failed"] == {reason: 1 for _, reason in RECORDED.values() if reason}
    counted = 10 - 3  # two answers of ollama and the HTML page come without token counts
    assert report["prompt_tokens"] == 2514 * counted
    assert report["cost"] == pytest.approx((2514 * 2 + 97 * 10) * counted / 1e6)


def test_the_raw_answer_of_a_failure_is_kept_truncated(
    bench: Bench, endpoint: "ChatEndpoint"
) -> None:
    (sample,) = bench.add_samples(1)
    endpoint.answer = lambda seen: endpoint.says("no " * 5000)
    bench.report("remind", exit_code=2)
    assert bench.journal()[sample]["raw"] == ("no " * 5000)[:2000]


def test_a_second_run_skips_what_is_done_and_asks_again_what_failed(
    bench: Bench, endpoint: "ChatEndpoint", record: dict[str, Any]
) -> None:
    samples = bench.add_samples(4)
    good = endpoint.says(json.dumps(record))
    endpoint.answer = lambda seen: good if shade_of(seen) != 2 else endpoint.says("hm")
    assert bench.report("remind")["answered"] == 3
    endpoint.answer = lambda seen: good
    report = bench.report("remind")
    assert (report["asked"], report["answered"]) == (1, 4)
    assert [shade_of(seen) for seen in endpoint.seen[4:]] == [2]
    assert bench.journal()[samples[2]]["reminder"] == record
    assert bench.report("remind")["requests"] == 0


def test_a_sample_whose_images_are_missing_or_damaged_is_null_and_never_sent(
    bench: Bench, endpoint: "ChatEndpoint", record: dict[str, Any]
) -> None:
    first, second, third = bench.add_samples(3)
    (bench.images / first / "front.png").unlink()
    (bench.images / second / "front.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    bench.write_manifest([first, second, third, "not-in-the-folder"])
    endpoint.answer = lambda seen: endpoint.says(json.dumps(record))
    report = bench.report("remind", "--manifest", str(bench.manifest))
    assert report["failed"] == {"no_images": 2, "unreadable_image": 1}
    assert (report["samples"], report["answered"], report["requests"]) == (4, 1, 1)


def test_no_more_than_concurrency_samples_are_in_flight_and_that_many_are(
    bench: Bench, endpoint: "ChatEndpoint", record: dict[str, Any]
) -> None:
    bench.add_samples(12)
    together = threading.Barrier(3)

    def answer(seen: "Seen") -> Any:
        together.wait(timeout=20)  # breaks, and answers nothing, unless three requests meet
        return endpoint.says(json.dumps(record))

    endpoint.answer = answer
    assert bench.report("remind", "--concurrency", "3")["done"] == 12
    assert endpoint.most_in_flight == 3


def test_limit_asks_the_next_few_samples_only(
    bench: Bench, endpoint: "ChatEndpoint", record: dict[str, Any]
) -> None:
    bench.add_samples(5)
    endpoint.answer = lambda seen: endpoint.says(json.dumps(record))
    assert bench.report("remind", "--limit", "2")["answered"] == 2
    assert bench.report("remind", "--limit", "2")["answered"] == 4


def test_views_are_named_to_the_model_and_their_number_must_fit(
    bench: Bench, endpoint: "ChatEndpoint", record: dict[str, Any]
) -> None:
    bench.add_samples(1)
    endpoint.answer = lambda seen: endpoint.says(json.dumps(record))
    bench.report("remind", "--views", "front")
    assert endpoint.seen[0].texts[1] == "Image 1 of 1 (front):"
    bench.reminders.unlink()
    report = bench.report("remind", "--views", "front,back", exit_code=2)
    assert report["failed"] == {"wrong_image_count": 1}
    assert report["failure"] == "--views names 2 views, the sample has 1 image"


def test_an_answer_that_was_cut_is_asked_again_under_a_higher_limit_in_the_same_journal(
    bench: Bench, endpoint: "ChatEndpoint", record: dict[str, Any]
) -> None:
    bench.add_samples(2)
    good = endpoint.says(json.dumps(record))
    cut = endpoint.says('{"hazard', finish_reason="length")
    endpoint.answer = lambda seen: cut if shade_of(seen) else good
    assert bench.report("remind")["failed"] == {"truncated": 1}
    endpoint.answer = lambda seen: good
    report = bench.report("remind", "--max-tokens", "2000")
    assert (report["asked"], report["answered"]) == (1, 2)
    assert endpoint.seen[-1].document["max_tokens"] == 2000


def test_a_journal_of_another_model_is_not_mixed_in(
    bench: Bench, endpoint: "ChatEndpoint", record: dict[str, Any]
) -> None:
    bench.add_samples(1)
    endpoint.answer = lambda seen: endpoint.says(json.dumps(record))
    bench.report("remind")
    other = ("--temperature", "0.5", "--views", "front", "--extra-body", '{"seed": 1}')
    result = bench.run("remind", *other)
    assert result.exit_code == 2
    assert "other settings: --views, --temperature, --extra-body." in " ".join(
        result.stderr.split()
    )
    assert len(endpoint.seen) == 1
