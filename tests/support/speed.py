"""A pytest plugin: nothing is done twice that can be done once, and no process idles at the end.

Statements are compiled once per process: a test has a database of its own and so an engine of its own,
which would compile each statement anew, a quarter of the processor time of a test on the API.
Certificates of authorities are read once per process, not for every client (25 ms each); one that a
test names is read every time: it may have been replaced. Applications answer on one event loop, as in
a server: a `TestClient` would start one, and a thread with it, for every request (0.8 ms each). Files that
take longest come first: xdist would start with those of most tests, and a browser or a deployment of
its own has few. What collecting the tests has made stays to the end, so the collector of garbage looks
at none of it.
"""

import gc
import os
import ssl
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import cache
from typing import Any

import certifi
import pytest
from anyio.from_thread import BlockingPortal, start_blocking_portal
from sqlalchemy import Engine
from sqlalchemy.util import LRUCache
from starlette.testclient import TestClient

from exceptiondrive_records.db import database

HEAVIEST = (
    "tests/chaos/test_faults_sqlite_2.py",
    "tests/chaos/test_faults_sqlite_1.py",
    "tests/end_to_end/test_quick_start.py",
    "tests/end_to_end/test_on_the_sample.py",
    "tests/end_to_end/test_main_job.py",
    "tests/server/test_openapi.py",
    "tests/end_to_end/test_building_a_split.py",
    "tests/phases/test_kept_pages.py",
    "tests/operating/test_production_topology.py",
    "tests/chaos/test_faults_postgres.py",
    "tests/end_to_end/test_season.py",
    "tests/launcher/test_launch.py",
    "tests/launcher/test_own_split.py",
    "tests/server/pages/test_in_a_browser.py",
    "tests/phases/test_hidden.py",
    "tests/worker/test_with_real_broker.py",
    "tests/operating/test_bare_walk.py",
    "tests/build/test_review_in_a_browser.py",
    "tests/access/test_real_server.py",
    "tests/operating/test_running_server.py",
    "tests/rescoring/test_runs.py",
    "tests/phases/test_parts.py",
    "tests/client/test_action.py",
    "tests/leak/test_channels.py",
)
"""The longest first, as measured in docs/testing.md."""
# None: as OpenSSL was built; others as the HTTP libraries choose, which take the environment's word
OF_THE_MACHINE = (None, certifi.where(), os.environ.get("SSL_CERT_FILE"))
FIRST: dict[str, Any] = {}
"""By backend, the engine whose dialect and cache the later ones take over."""
TO_THE_END = ExitStack()
SELDOM = (20_000, 50, 100)
"""When garbage is collected: tests hold little, and look at it as seldom as they can."""


def pytest_configure(config: pytest.Config) -> None:
    database._engine = sharing(database._engine)  # type: ignore[assignment]
    ssl.create_default_context = read_once(ssl.create_default_context)
    TestClient._portal_factory = loop_of  # type: ignore[assignment, method-assign]
    gc.disable()


def pytest_unconfigure() -> None:
    TO_THE_END.close()


def pytest_collection_finish() -> None:
    gc.collect()
    gc.freeze()
    gc.set_threshold(*SELDOM)
    gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    rank = {path: place for place, path in enumerate(HEAVIEST)}
    items.sort(key=lambda item: rank.get(item.nodeid.partition("::")[0], len(rank)))


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


def read_once(make: Callable[..., ssl.SSLContext]) -> Callable[..., ssl.SSLContext]:
    """Wrap what makes TLS contexts; the one with the machine's certificates is kept."""
    once = cache(make)

    def made(*purpose: Any, **certificates: Any) -> ssl.SSLContext:
        is_lasting = certificates.get("cafile") in OF_THE_MACHINE
        return (once if is_lasting else make)(*purpose, **certificates)

    return made


@contextmanager
def loop_of(client: TestClient) -> Iterator[BlockingPortal]:
    """Yield the event loop of a client that is entered, and that of all others."""
    yield client.portal or shared_loop()


@cache
def shared_loop() -> BlockingPortal:
    """Start the event loop of all clients of this process."""
    return TO_THE_END.enter_context(start_blocking_portal())
