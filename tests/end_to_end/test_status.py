"""A real worker is stopped: visitors are told, on the front page and at /status, until it goes on."""

import signal
from pathlib import Path

import pytest
from tests.support.processes import wait_until
from tests.support.system import running_system

pytestmark = [pytest.mark.slow]


def test_the_front_page_says_when_a_worker_stands_still(tmp_path: Path) -> None:
    (tmp_path / "splits").mkdir()
    with running_system(tmp_path / "data", tmp_path / "splits") as system:
        assert system.get("/status")["state"] == "up"
        assert "Scoring is delayed" not in system.read("/")

        def is_delayed() -> bool:
            system.signal_workers(signal.SIGSTOP)  # also those that have begun meanwhile
            return bool(system.get("/status")["state"] == "delayed")

        try:
            wait_until(is_delayed, "the status", 120)
            wait_until(lambda: "Scoring is delayed" in system.read("/"), "the front page", 60)
            assert system.get("/status")["live_workers"] == 0
            assert "no worker is alive" in system.read("/status")
        finally:
            system.signal_workers(signal.SIGCONT)
        wait_until(lambda: system.get("/status")["state"] == "up", "the worker", 120)
        wait_until(lambda: "Scoring is delayed" not in system.read("/"), "the front page", 60)
