"""A run that is killed goes on where it was: nothing finished is asked twice, nothing is lost."""

import json
import os
import signal
import subprocess
import sys
import threading
from typing import TYPE_CHECKING, Any

from tests.agent.bench import Bench, shade_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.chat_endpoint import ChatEndpoint, Reply, Seen


def test_after_sigkill_midway_the_same_command_finishes_and_asks_only_what_is_open(
    bench: Bench, endpoint: "ChatEndpoint", record: dict[str, Any]
) -> None:
    samples = bench.add_samples(12)
    midway, released = threading.Event(), threading.Event()

    def answer(seen: "Seen") -> "Reply":
        if shade_of(seen) >= 6:  # two workers: samples 6 and 7 are in flight when the kill comes
            midway.set()
            released.wait(timeout=60)
        return endpoint.says(json.dumps(record))

    endpoint.answer = answer
    command = [sys.executable, "-m", "exceptiondrive"]
    process = subprocess.Popen(
        [*command, *bench.arguments("remind", "--concurrency", "2")],
        env=os.environ | {"NO_PROXY": "127.0.0.1"},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    assert midway.wait(timeout=60)
    wait_for_lines(bench, 5)
    process.send_signal(signal.SIGKILL)
    assert process.wait(timeout=60) == -signal.SIGKILL
    released.set()

    finished = {key for key, line in bench.journal().items() if "reminder" in line}
    assert 5 <= len(finished) < 12
    endpoint.seen.clear()
    endpoint.answer = lambda seen: endpoint.says(json.dumps(record))
    report = bench.report("remind")
    assert report["answered"] == 12
    asked = {samples[shade_of(seen)] for seen in endpoint.seen}
    assert asked == set(samples) - finished
    assert set(bench.journal()) == set(samples)


def test_ctrl_c_midway_says_what_was_spent_and_writes_what_there_is(
    bench: Bench, endpoint: "ChatEndpoint"
) -> None:
    bench.add_samples(4)
    midway, released = threading.Event(), threading.Event()

    def answer(seen: "Seen") -> "Reply":
        if shade_of(seen) == 2:
            midway.set()
            released.wait(timeout=60)
        return endpoint.says('{"strategy": "C"}')

    endpoint.answer = answer
    program = (
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler);"
        "from exceptiondrive.cli import main; main()"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", program, *bench.arguments("decide", "--concurrency", "1")],
        env=os.environ | {"NO_PROXY": "127.0.0.1"},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert midway.wait(timeout=60)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    released.set()
    assert process.returncode == 130
    assert "tokens       2000 in, 100 out" in said
    assert "Interrupted. Answers so far are kept; run the same command to go on." in said
    letters = [each["strategy"] for each in bench.submission()["predictions"]]
    assert letters == ["C", "C", None, None]


def refuses_below(endpoint: "ChatEndpoint", shade: int) -> "Callable[[Seen], Reply]":
    """Refuse the pictures of the first samples, as a content policy would; answer the others."""

    def answer(seen: "Seen") -> "Reply":
        if shade_of(seen) < shade:
            return endpoint.fails(400, "content policy")
        return endpoint.says('{"strategy": "C"}')

    return answer


def test_samples_that_have_not_been_asked_come_before_those_that_failed(
    bench: Bench, endpoint: "ChatEndpoint"
) -> None:
    bench.add_samples(5)
    endpoint.answer = refuses_below(endpoint, 2)
    assert bench.report("decide", "--limit", "3")["failed"] == {"request_refused": 2}
    endpoint.seen.clear()
    assert bench.report("decide", "--limit", "3", "--concurrency", "1")["answered"] == 3
    assert [shade_of(seen) for seen in endpoint.seen][:2] == [3, 4]


def test_what_an_endpoint_that_answers_refuses_does_not_stop_a_run_nor_its_repetition(
    bench: Bench, endpoint: "ChatEndpoint"
) -> None:
    bench.add_samples(30)
    endpoint.answer = lambda seen: endpoint.says('{"strategy": "C"}')
    bench.report("decide", "--limit", "1")
    endpoint.answer = refuses_below(endpoint, 25)
    for asked in (29, 24):
        report = bench.report("decide", "--concurrency", "1")
        assert (report["asked"], report["failed"]) == (asked, {"request_refused": 24})
        assert report["answered"] == 6


def wait_for_lines(bench: Bench, count: int) -> None:
    """Wait until the journal holds so many lines; the run has already asked for more."""
    pause = threading.Event()
    for _ in range(600):
        if bench.reminders.exists() and len(bench.journal()) >= count:
            return
        pause.wait(0.1)
    raise AssertionError("the journal did not grow")
