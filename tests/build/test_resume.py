"""A stage that is killed goes on where it was: what was answered is not asked again."""

import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

from tests.build.test_stages import change, report, walked
from tests.support.chat_endpoint import Reply, Seen
from tests.support.stand_in import StandIn, form_fields

IN_FLIGHT = 2
RUN = "from exceptiondrive_build.cli import main; main()"


def test_after_sigkill_midway_only_what_was_in_flight_is_asked_twice(
    shop: Path, stand_in: StandIn
) -> None:
    change(shop, "workshop.toml", "concurrency = 8", f"concurrency = {IN_FLIGHT}")
    for stage, kill_after in (("screen", 7), ("edit", 3), ("review", 4)):
        stand_in.seen.clear()
        midway, released = threading.Event(), threading.Event()

        def fault(seen: Seen) -> Reply | None:
            if len(stand_in.seen) > kill_after:  # noqa: B023
                midway.set()  # noqa: B023
                released.wait(timeout=60)  # noqa: B023
            return None

        stand_in.fault = fault
        command = [sys.executable, "-c", RUN, "run", stage, "-w", str(shop)]
        process = subprocess.Popen(
            command, env=os.environ.copy(), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        assert midway.wait(timeout=60)
        process.send_signal(signal.SIGKILL)
        assert process.wait(timeout=60) == -signal.SIGKILL
        released.set()
        stand_in.fault = lambda seen: None
        assert report(shop, stage)["still_open"] == 0
        asked = [
            str(sorted(form_fields(seen).items())).encode() if stage == "edit" else seen.body
            for seen in stand_in.seen
        ]
        assert len(asked) - len(set(asked)) <= IN_FLIGHT
    suitable = [c for c in walked(shop).values() if c.is_suitable]
    assert suitable
    assert all(candidate.reviewed is not None for candidate in suitable)
    with (shop / "answers" / "screen.jsonl").open("rb") as file:
        assert sum(1 for _ in file) == 1 + 18


def test_ctrl_c_keeps_the_answers_and_says_how_to_go_on(shop: Path, stand_in: StandIn) -> None:
    change(shop, "workshop.toml", "concurrency = 8", f"concurrency = {IN_FLIGHT}")
    midway, released = threading.Event(), threading.Event()

    def fault(seen: Seen) -> Reply | None:
        if len(stand_in.seen) > 7:
            midway.set()
            released.wait(timeout=60)
        return None

    stand_in.fault = fault
    listening = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler);"
    process = subprocess.Popen(
        [sys.executable, "-c", f"{listening} {RUN}", "run", "screen", "-w", str(shop)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert midway.wait(timeout=60)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    released.set()
    assert process.returncode == 130
    assert "Answers so far are kept; run the same command to go on." in said
    kept = (shop / "answers" / "screen.jsonl").read_bytes().count(b"\n") - 1
    stand_in.fault = lambda seen: None
    stand_in.seen.clear()
    assert report(shop, "screen")["still_open"] == 0
    assert 0 < kept
    assert len(stand_in.seen) == 18 - kept
