"""`exceptiondrive decide`, end to end against a real HTTP server."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tests.agent.bench import Bench, shade_of

from exceptiondrive.inputs import given_manifest
from exceptiondrive_schemas.check import check
from exceptiondrive_schemas.protocol import packaged_protocol, packaged_protocol_toml

if TYPE_CHECKING:
    from tests.support.chat_endpoint import ChatEndpoint, Reply, Seen


def faults_of(bench: Bench) -> list[str]:
    """What the server's own checker finds wrong with the submission."""
    manifest = given_manifest(bench.manifest)
    report = check(bench.out.read_bytes(), protocol=packaged_protocol(), manifest=manifest).report
    assert report.challenge == "strategy"
    return [group.message for group in report.faults]


def answer_both(
    endpoint: "ChatEndpoint", record: dict[str, Any], letter: str = "C"
) -> Callable[["Seen"], "Reply"]:
    """Answer a reminder question with the record and a decision with the letter."""

    def answer(seen: "Seen") -> "Reply":
        is_reminder = "risk reminder" in seen.texts[0]
        return endpoint.says(json.dumps(record if is_reminder else {"strategy": letter}))

    return answer


def test_the_submission_is_valid_and_null_where_the_answer_is_not(
    bench: Bench, endpoint: "ChatEndpoint"
) -> None:
    samples = bench.add_samples(4)
    bench.write_manifest([*samples, "without-images"])
    texts = ['{"strategy": "B"}', "C", "I would stop or yield.", '{"strategy": "stop"}']
    endpoint.answer = lambda seen: endpoint.says(texts[shade_of(seen)])
    report = bench.report("decide")
    assert faults_of(bench) == []
    assert [p["strategy"] for p in bench.submission()["predictions"]] == ["B", "C"] + [None] * 3
    assert bench.submission()["split"] == "sample-strategy"
    assert report["failed"] == {"not_json": 1, "wrong_schema": 1, "no_images": 1}
    assert (report["samples"], report["answered"], report["given_reminders"]) == (5, 2, 0)


def test_the_reminder_is_the_only_difference_between_the_two_settings(
    bench: Bench, endpoint: "ChatEndpoint", record: dict[str, Any]
) -> None:
    bench.add_samples(3)
    endpoint.answer = answer_both(endpoint, record)
    bench.report("decide")
    baseline = {shade_of(seen): seen.document for seen in endpoint.seen}
    bench.report("remind")
    endpoint.seen.clear()
    journal = bench.folder / "with.jsonl"
    more = ("--reminders", str(bench.reminders), "--journal", str(journal))
    assert bench.report("decide", *more)["given_reminders"] == 3
    assert len(endpoint.seen) == 3
    for seen in endpoint.seen:
        given = seen.document
        added = given["messages"][1]["content"].pop()
        assert added["text"].startswith("Risk reminder, written by an auxiliary agent")
        assert given == baseline[shade_of(seen)]


def test_reminder_records_travel_with_the_answers_only_when_asked_for(
    bench: Bench, endpoint: "ChatEndpoint", record: dict[str, Any]
) -> None:
    bench.add_samples(2)
    endpoint.answer = answer_both(endpoint, record)
    bench.report("remind")
    more = ("--reminders", str(bench.reminders))
    bench.report("decide", *more)
    assert all("reminder" not in p for p in bench.submission()["predictions"])
    bench.report("decide", *more, "--attach-reminders")
    assert [p["reminder"] for p in bench.submission()["predictions"]] == [record, record]
    assert faults_of(bench) == []


def test_a_sample_whose_reminder_failed_is_asked_without_and_again_once_it_has_one(
    bench: Bench, endpoint: "ChatEndpoint", record: dict[str, Any]
) -> None:
    bench.add_samples(2)
    endpoint.answer = lambda seen: endpoint.says(json.dumps(record) if shade_of(seen) else "hm")
    bench.report("remind")
    endpoint.answer = answer_both(endpoint, record)
    more = ("--reminders", str(bench.reminders), "--attach-reminders")
    first = bench.report("decide", *more)
    assert (first["asked"], first["given_reminders"]) == (2, 1)
    assert ["reminder" in p for p in bench.submission()["predictions"]] == [False, True]
    bench.report("remind")
    second = bench.report("decide", *more)
    assert (second["asked"], second["given_reminders"]) == (1, 1)
    assert all("reminder" in p for p in bench.submission()["predictions"])


def test_the_two_settings_never_share_a_journal(
    bench: Bench, endpoint: "ChatEndpoint", record: dict[str, Any]
) -> None:
    bench.add_samples(1)
    endpoint.answer = answer_both(endpoint, record)
    bench.report("remind")
    bench.report("decide")
    result = bench.run("decide", "--reminders", str(bench.reminders))
    assert result.exit_code == 2
    assert "and other settings: --reminders or none." in result.stderr


def test_reminders_of_other_samples_or_of_no_journal_are_refused(
    bench: Bench, endpoint: "ChatEndpoint", record: dict[str, Any], tmp_path: Path
) -> None:
    samples = bench.add_samples(1)
    endpoint.answer = answer_both(endpoint, record)
    bench.report("remind")
    bench.report("decide")
    decisions = f"{bench.out}.journal.jsonl"
    (bench.images / "other").mkdir()
    (bench.images / samples[0] / "front.png").rename(bench.images / "other" / "front.png")
    bench.write_manifest(["other"])
    for reminders, said in (
        (str(bench.reminders), "no reminder record for any sample"),
        (decisions, "takes the file of `remind`"),
        (str(bench.manifest), "not a journal"),
        (str(tmp_path / "nowhere"), "nowhere"),
    ):
        result = bench.run("decide", "--reminders", reminders)
        assert (result.exit_code, said in result.stderr) == (2, True), result.stderr


def test_reminders_with_hazard_types_of_another_protocol_are_refused(
    bench: Bench, endpoint: "ChatEndpoint", record: dict[str, Any]
) -> None:
    bench.add_samples(1)
    endpoint.answer = answer_both(endpoint, record)
    bench.report("remind")
    bench.reminders.write_text(bench.reminders.read_text().replace('"LB1"', '"XX1"'))
    result = bench.run("decide", "--reminders", str(bench.reminders))
    assert result.exit_code == 2
    assert "hazard types that this protocol does not know: XX1" in result.stderr


def test_what_is_read_is_not_written_over(
    bench: Bench, endpoint: "ChatEndpoint", record: dict[str, Any]
) -> None:
    bench.add_samples(1)
    endpoint.answer = answer_both(endpoint, record)
    bench.report("remind")
    journal, rules = bench.folder / "j.jsonl", bench.folder / "rules.toml"
    rules.write_text(packaged_protocol_toml("1.1"))
    bench.report("decide", "--journal", str(journal))
    listed = bench.folder / "images.json"
    listed.write_text('{"sample-000": ["images/sample-000/front.png"]}')
    bench.images = listed
    for read, *named in (
        (bench.manifest,),
        (listed,),
        (bench.reminders, "--reminders"),
        (journal, "--journal"),
        (rules, "--protocol"),
    ):
        kept, bench.out = read.read_bytes(), read
        result = bench.run("decide", *named, *[str(read)] * len(named))
        assert (result.exit_code, "is what is read" in result.stderr) == (2, True), read
        assert read.read_bytes() == kept


def test_attaching_needs_reminders(bench: Bench, endpoint: "ChatEndpoint") -> None:
    bench.add_samples(1)
    result = bench.run("decide", "--attach-reminders")
    assert (result.exit_code, endpoint.seen) == (2, [])
    assert "--attach-reminders needs --reminders" in result.stderr


def test_a_run_in_which_no_image_fits_says_what_is_expected_and_fails(
    bench: Bench, endpoint: "ChatEndpoint"
) -> None:
    _, cut = bench.add_samples(2)
    (bench.images / "sample-000" / "front.png").rename(bench.images / "front.png")
    (bench.images / cut / "front.png").write_bytes(b"no picture")
    result = bench.run("decide")
    assert (result.exit_code, endpoint.seen) == (2, [])
    assert "No image was found for 1 of 2 samples. Put them under IMAGES/<sample_id>/" in (
        result.stderr
    )
    assert "No sample has an answer: front.png: neither JPEG nor PNG." in result.stderr


def test_images_that_match_no_sample_of_the_manifest_stop_the_run(
    bench: Bench, endpoint: "ChatEndpoint"
) -> None:
    bench.add_samples(1)
    bench.write_manifest(["something-else"])
    result = bench.run("decide")
    assert (result.exit_code, endpoint.seen, bench.out.exists()) == (2, [], False)
    assert "must be the sample ids" in result.stderr
