"""How endpoints fail, and what a run does about it."""

import asyncio
import gzip
import json
import threading
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest
from tests.agent.bench import Bench, shade_of

from exceptiondrive_agent.questions import messages
from exceptiondrive_endpoints.endpoint import (
    MAX_ANSWER_BYTES,
    Endpoint,
    EndpointSettings,
    ModelSettings,
)

if TYPE_CHECKING:
    from tests.support.chat_endpoint import ChatEndpoint, Reply, Seen

KEY = "key-of-the-tests-0123456789"
DECISION = '{"strategy": "C"}'


class Sequence:
    """Answers with one reply after the other, then with the last for ever."""

    def __init__(self, *replies: "Reply") -> None:
        self._replies = list(replies)

    def __call__(self, seen: "Seen") -> "Reply":
        return self._replies.pop(0) if len(self._replies) > 1 else self._replies[0]


def test_429_with_retry_after_is_waited_for_and_asked_again(
    bench: Bench, endpoint: "ChatEndpoint"
) -> None:
    bench.add_samples(1)
    busy = endpoint.fails(429, headers={"Retry-After": "0.2"})
    endpoint.answer = Sequence(busy, busy, endpoint.says(DECISION))
    report = bench.report("decide")
    assert (report["done"], report["requests"], len(endpoint.seen)) == (1, 3, 3)


def test_a_proxy_that_cannot_be_used_ends_the_run_in_words(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.add_samples(1)
    monkeypatch.setenv("ALL_PROXY", "socks5://127.0.0.1:9")
    result = bench.run("decide")
    assert result.exit_code == 2
    assert "Look at HTTP_PROXY, HTTPS_PROXY, ALL_PROXY" in result.stderr


@pytest.mark.parametrize("status", [500, 503])
def test_a_server_error_is_asked_again(bench: Bench, endpoint: "ChatEndpoint", status: int) -> None:
    bench.add_samples(1)
    broken = endpoint.fails(status, headers={"retry-after-ms": "20"})
    endpoint.answer = Sequence(broken, endpoint.says(DECISION))
    assert bench.report("decide")["done"] == 1


@pytest.mark.parametrize(
    ("status", "reason"), [(429, "rate_limited"), (500, "server_error"), (503, "server_error")]
)
def test_after_the_last_retry_the_sample_is_null_and_the_exit_code_says_network(
    bench: Bench, endpoint: "ChatEndpoint", status: int, reason: str
) -> None:
    (sample,) = bench.add_samples(1)
    broken = endpoint.fails(status, headers={"retry-after-ms": "20"})
    endpoint.answer = Sequence(broken)
    report = bench.report("decide", "--max-retries", "2", exit_code=5)
    assert report["failed"] == {reason: 1}
    assert report["requests"] == 3
    assert bench.submission()["predictions"] == [{"sample_id": sample, "strategy": None}]


def test_an_endpoint_that_is_too_slow_is_a_timeout(bench: Bench, endpoint: "ChatEndpoint") -> None:
    bench.add_samples(1)
    gone = threading.Event()

    def answer(seen: "Seen") -> "Reply":
        gone.wait(timeout=20)
        return endpoint.says(DECISION)

    endpoint.answer = answer
    report = bench.report("decide", "--timeout-s", "0.2", "--max-retries", "0", exit_code=5)
    gone.set()
    assert report["failed"] == {"timeout": 1}


def test_an_answer_that_comes_byte_by_byte_without_an_end_is_a_timeout(
    bench: Bench, endpoint: "ChatEndpoint"
) -> None:
    """None of its pauses is one; whole it would come after a minute."""
    bench.add_samples(1)
    whole = endpoint.says(DECISION)
    endpoint.answer = Sequence(replace(whole, pause_s=60 / len(whole.body)))
    slow = ("--timeout-s", "0.4", "--max-retries", "0")
    assert "no end of an answer within 4 s" in bench.report("decide", *slow, exit_code=5)["failure"]
    assert [line["reason"] for line in bench.journal(journal_of(bench)).values()] == ["timeout"]


def test_an_answer_that_unpacks_without_an_end_is_left(
    bench: Bench, endpoint: "ChatEndpoint"
) -> None:
    bench.add_samples(1)
    bomb = gzip.compress(b" " * (MAX_ANSWER_BYTES + 1))
    endpoint.answer = Sequence(
        replace(endpoint.says(DECISION), body=bomb, headers={"content-encoding": "gzip"})
    )
    report = bench.report("decide", exit_code=5)
    assert "256,000,000 bytes" in report["failure"]
    assert (report["failed"], report["requests"]) == ({"timeout": 1}, 1)


def test_a_retry_after_that_is_too_long_to_wait_for_is_told(
    bench: Bench, endpoint: "ChatEndpoint"
) -> None:
    bench.add_samples(1)
    endpoint.answer = Sequence(endpoint.fails(429, "slow down.", headers={"Retry-After": "3600"}))
    report = bench.report("decide", "--max-retries", "0", exit_code=5)
    assert report["failure"] == "HTTP 429: slow down (Retry-After: 3600)"


@pytest.mark.parametrize(
    ("body", "said"),
    [
        (b'{"error": {"message": "loading"}}', '{"error": {"message": "loading"}}'),
        (b"<p>Welcome.</p>", "<p>Welcome.</p>"),
        (f"[{KEY!r}]".encode(), "['***']"),
        (b"", "it is empty"),
    ],
)
def test_what_is_no_chat_completion_is_quoted(
    bench: Bench, endpoint: "ChatEndpoint", body: bytes, said: str
) -> None:
    bench.add_samples(1)
    endpoint.answer = Sequence(replace(endpoint.says(DECISION), body=body))
    result = bench.run("decide")
    assert result.exit_code == 2
    assert f"the response is no chat completion: {said}." in " ".join(result.stderr.split())


def test_where_there_is_no_key_nothing_is_left_out_of_the_words(
    bench: Bench, endpoint: "ChatEndpoint", monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("EXCEPTIONDRIVE_AGENT_KEY")
    bench.add_samples(1)
    endpoint.answer = Sequence(endpoint.fails(429, "slow down."))
    report = bench.report("decide", "--max-retries", "0", exit_code=5)
    assert report["failure"] == "HTTP 429: slow down"


@pytest.mark.parametrize(
    "usage",
    ["many", {"prompt_tokens": -1}, {"prompt_tokens": "few"}, {"completion_tokens": 10**30}],
)
def test_counts_that_cannot_be_read_spoil_no_answer(
    bench: Bench, endpoint: "ChatEndpoint", usage: object
) -> None:
    bench.add_samples(1)
    whole = endpoint.says(DECISION)
    body = json.dumps({**json.loads(whole.body), "usage": usage}).encode()
    endpoint.answer = Sequence(replace(whole, body=body))
    report = bench.report("decide")
    assert (report["done"], report["without_token_counts"]) == (1, 1)


def test_a_certificate_of_an_unknown_signer_says_where_to_name_it(
    bench: Bench, endpoint: "ChatEndpoint"
) -> None:
    bench.add_samples(1)
    endpoint.speak_tls(bench.images.parent)
    result = bench.run("decide", "--max-retries", "0")
    assert (result.exit_code, endpoint.seen) == (5, [])
    assert "name the certificate that signed it in SSL_CERT_FILE" in result.stderr


def test_a_response_that_breaks_off_is_a_lost_connection_and_asked_again(
    bench: Bench, endpoint: "ChatEndpoint"
) -> None:
    bench.add_samples(1)
    whole = endpoint.says(DECISION)
    cut = type(whole)(whole.body[:40], announced_bytes=len(whole.body))
    endpoint.answer = Sequence(cut, whole)
    assert bench.report("decide")["done"] == 1


def test_without_an_endpoint_the_sample_is_null_with_no_connection(
    bench: Bench, endpoint: "ChatEndpoint"
) -> None:
    bench.add_samples(1)
    closed = ("--base-url", "http://127.0.0.1:1/v1", "--max-retries", "0")
    result = bench.run("decide", *closed)
    assert endpoint.seen == []
    assert result.exit_code == 5
    assert "1 connection" in result.stdout
    assert "1 sample could not be asked: no connection to http://127.0.0.1:1/v1" in result.stderr
    assert "If --base-url is right, run the same command again." in result.stderr


def test_a_refused_key_stops_the_run_at_once_and_is_not_repeated_in_the_message(
    bench: Bench, endpoint: "ChatEndpoint"
) -> None:
    bench.add_samples(30)
    endpoint.answer = Sequence(endpoint.fails(401, f"Incorrect API key provided: {KEY}"))
    result = bench.run("decide", "--concurrency", "1")
    assert (result.exit_code, len(endpoint.seen), bench.out.exists()) == (4, 1, False)
    assert "EXCEPTIONDRIVE_AGENT_KEY" in result.stderr
    assert KEY not in result.output


@pytest.mark.parametrize(
    ("status", "code", "exit_code", "said"),
    [
        (404, "model_not_found", 2, "/v1 knows no such address, or no model tested-model"),
        (404, "model_not_found", 2, "Correct --base-url or --model."),
        (402, None, 4, "used up"),
        (429, "insufficient_quota", 4, "used up"),
    ],
)
def test_what_no_sample_can_survive_stops_the_run(
    bench: Bench,
    endpoint: "ChatEndpoint",
    status: int,
    code: str | None,
    exit_code: int,
    said: str,
) -> None:
    bench.add_samples(3)
    endpoint.answer = Sequence(endpoint.fails(status, code=code))
    result = bench.run("decide", "--max-retries", "0", "--concurrency", "1")
    assert (result.exit_code, len(endpoint.seen)) == (exit_code, 1)
    assert said in result.stderr


@pytest.mark.parametrize("more", [(), ("--json",)])
def test_a_run_that_stops_early_says_what_it_spent_and_writes_what_there_is(
    bench: Bench, endpoint: "ChatEndpoint", more: tuple[str, ...]
) -> None:
    bench.add_samples(5)
    answered = [endpoint.says(DECISION)] * 3
    endpoint.answer = Sequence(*answered, endpoint.fails(402))
    prices = ("--price-in", "1", "--price-out", "2")
    result = bench.run("decide", "--concurrency", "1", *prices, *more)
    assert result.exit_code == 4
    for said in (
        "samples      5, with an answer 3",
        "requests     4,",
        "tokens       3000 in, 150 out",
        "cost         0.0033",
        f"written to   {bench.out}",
        "Answers so far are kept; run the same command to go on.",
    ):
        assert said in result.stderr
    assert list(json.loads(result.stdout)) == ["error"] if more else result.stdout == ""
    letters = [each["strategy"] for each in bench.submission()["predictions"]]
    assert letters == ["C", "C", "C", None, None]


@pytest.mark.parametrize(("at_a_time", "status"), [(1, 503), (2, 503), (1, 307)])
def test_an_endpoint_that_has_gone_or_refuses_all_stops_the_run_after_twenty_samples_in_a_row(
    bench: Bench, endpoint: "ChatEndpoint", at_a_time: int, status: int
) -> None:
    bench.add_samples(40)
    endpoint.answer = Sequence(endpoint.fails(status))
    result = bench.run("decide", "--max-retries", "0", "--concurrency", str(at_a_time))
    assert result.exit_code == 5
    assert "20 samples in a row" in result.stderr
    assert 20 <= len(endpoint.seen) < 20 + at_a_time


def test_unusable_answers_do_not_stop_a_run(bench: Bench, endpoint: "ChatEndpoint") -> None:
    bench.add_samples(25)
    endpoint.answer = Sequence(endpoint.says("hm"))
    assert bench.report("decide", exit_code=2)["failed"] == {"not_json": 25}


def test_an_endpoint_without_structured_output_is_asked_in_plainer_forms_and_remembered(
    bench: Bench, endpoint: "ChatEndpoint"
) -> None:
    bench.add_samples(3)

    def answer(seen: "Seen") -> "Reply":
        if seen.form != "words":
            return endpoint.fails(400, "response_format is not supported")
        return endpoint.says(DECISION)

    endpoint.answer = answer
    assert bench.report("decide", "--concurrency", "1")["done"] == 3
    forms = [seen.form for seen in endpoint.seen]
    assert forms == ["json_schema", "json_object", "words", "words", "words"]
    assert {line["form"] for line in bench.journal(journal_of(bench)).values()} == {"words"}


def test_a_renamed_token_limit_and_a_fixed_temperature_are_met(
    bench: Bench, endpoint: "ChatEndpoint"
) -> None:
    bench.add_samples(2)

    def answer(seen: "Seen") -> "Reply":
        for name in ("max_tokens", "temperature"):
            if name in seen.document:
                return endpoint.fails(400, "unsupported", param=name, code="unsupported_parameter")
        return endpoint.says(DECISION)

    endpoint.answer = answer
    assert bench.report("decide", "--concurrency", "1")["done"] == 2
    last = endpoint.seen[-1]
    assert (last.form, last.document["max_completion_tokens"]) == ("json_schema", 1000)
    assert len(endpoint.seen) == 4


def test_a_request_that_is_refused_in_every_form_is_null_and_spoils_no_other(
    bench: Bench, endpoint: "ChatEndpoint"
) -> None:
    bench.add_samples(2)
    endpoint.answer = lambda seen: (
        endpoint.fails(400, "image too small") if shade_of(seen) == 0 else endpoint.says(DECISION)
    )
    report = bench.report("decide", "--concurrency", "1")
    assert (report["done"], report["failed"]) == (1, {"request_refused": 1})
    assert endpoint.seen[-1].form == "json_schema"
    (failed,) = [line for line in bench.journal(journal_of(bench)).values() if "reason" in line]
    assert "image too small" in failed["detail"]


def test_a_redirect_is_not_followed_so_images_go_nowhere_else(
    bench: Bench, endpoint: "ChatEndpoint"
) -> None:
    bench.add_samples(1)
    elsewhere = {"Location": f"{endpoint.base_url}/elsewhere"}
    endpoint.answer = Sequence(endpoint.fails(307, headers=elsewhere))
    result = bench.run("decide")
    assert (result.exit_code, len(endpoint.seen)) == (2, 1)
    assert "1 request_refused" in result.stdout
    said = f"it leads to {endpoint.base_url}/elsewhere, and no redirect is followed"
    assert said in result.stderr


async def test_every_http_request_waits_for_its_slot_retries_included(
    endpoint: "ChatEndpoint", monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = endpoint.fails(503, headers={"retry-after-ms": "1"})
    endpoint.answer = Sequence(broken, endpoint.says(DECISION))
    waits_s: list[float] = []

    async def sleep(delay_s: float) -> None:
        waits_s.append(delay_s)

    monkeypatch.setattr(asyncio, "sleep", sleep)
    settings = EndpointSettings(base_url=endpoint.base_url, requests_per_minute=0.1)
    async with Endpoint(settings, ModelSettings(model="m")) as client:
        for _ in range(3):
            await client.complete(messages("look", ()), "decide", {})
        assert client.n_requests == len(endpoint.seen) == 4
    assert [round(wait_s / 600) for wait_s in waits_s] == [0, 1, 2, 3]  # ten minutes a slot


def test_extra_fields_reach_the_endpoint(bench: Bench, endpoint: "ChatEndpoint") -> None:
    bench.add_samples(1)
    endpoint.answer = Sequence(endpoint.says(DECISION))
    bench.report("decide", "--extra-body", json.dumps({"seed": 7, "chat_template_kwargs": {}}))
    assert endpoint.seen[0].document["seed"] == 7
    assert endpoint.seen[0].document["chat_template_kwargs"] == {}


def journal_of(bench: Bench) -> Any:
    return bench.out.with_name(f"{bench.out.name}.journal.jsonl")
