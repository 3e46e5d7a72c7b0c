"""A pytest plugin: statements are compiled once per process, not once for every database.

A test has a database of its own and so an engine of its own, which compiles each statement when it is
used first: a quarter of the processor time of a test on the API.
"""

from collections.abc import Callable
from typing import Any

import pytest
from sqlalchemy import Engine
from sqlalchemy.util import LRUCache

from exceptiondrive_records.db import database

FIRST: dict[str, Any] = {}
"""By backend, the engine whose dialect and cache the later ones take over."""


def pytest_configure(config: pytest.Config) -> None:
    database._engine = sharing(database._engine)  # type: ignore[assignment]


def sharing(make: Callable[[str], Engine]) -> Callable[[str], Engine]:
    """Wrap what makes engines; a dialect is shared once it has met its server."""

    def made(url: str) -> Engine:
        engine: Any = make(url)
        first = FIRST.get(engine.name)
        if first is not None and getattr(first.dialect, "server_version_info", None):
            engine.dialect, engine._compiled_cache = first.dialect, first._compiled_cache
        else:
            engine._compiled_cache = LRUCache(10_000)
            FIRST[engine.name] = engine
        return engine  # type: ignore[no-any-return]

    return made
