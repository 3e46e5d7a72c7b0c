"""The endpoint of the tests, made images, and a folder to work in."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.agent.bench import KEY, Bench
from tests.support.chat_endpoint import ChatEndpoint


@pytest.fixture(autouse=True)
def own_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    """The key of the tests, and no proxy between us and the loopback."""
    for name in list(os.environ):
        if name.startswith("OPENAI_") or name.upper().endswith("_PROXY"):
            monkeypatch.delenv(name)
    monkeypatch.setenv("EXCEPTIONDRIVE_AGENT_KEY", KEY)


@pytest.fixture
def endpoint() -> Iterator[ChatEndpoint]:
    server = ChatEndpoint()
    yield server
    server.close()


@pytest.fixture
def bench(tmp_path: Path, endpoint: ChatEndpoint) -> Bench:
    return Bench(tmp_path, endpoint)


@pytest.fixture
def record() -> dict[str, Any]:
    """A reminder record as a model would write it."""
    return {
        "hazard_present": True,
        "hazard_type": "LB1",
        "relative_location": "ahead, about 15 m, in the ego lane",
        "risk_level": "high",
        "evidence": "a truck with warning lights stands across the lane",
        "safety_constraint": "stop before the truck",
        "recommended_strategy": "C",
    }
