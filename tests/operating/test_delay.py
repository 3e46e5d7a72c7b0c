"""A worker that stands still, stopped with its children: visitors are told, until it goes on."""

from typing import Any

import httpx
import pytest
from tests.chaos.topology import Topology

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]
WORDS = "Scoring is delayed: no worker is alive."


def test_visitors_are_told_while_a_worker_stands_still() -> None:
    topology = Topology(is_forked=True)

    def status() -> dict[str, Any]:
        found: dict[str, Any] = httpx.get(f"{topology.url}/api/v1/status", timeout=30).json()
        return found

    def page(path: str) -> str:
        return httpx.get(topology.url + path, timeout=30).text

    try:
        topology.wait_until(lambda: status()["state"] == "up", "the status at the start")
        assert WORDS not in page("/")
        topology.freeze_between_writes()
        topology.wait_until(lambda: status()["state"] == "delayed", "the status")
        assert status()["live_workers"] == 0
        topology.wait_until(lambda: WORDS in page("/"), "the front page")
        assert WORDS in page("/status")
        topology.worker.thaw()
        topology.wait_until(lambda: status()["state"] == "up", "the worker")
        topology.wait_until(lambda: WORDS not in page("/"), "the front page")
    finally:
        topology.close()
