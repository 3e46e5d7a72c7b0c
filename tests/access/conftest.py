"""A provider as a process, and people who sign in through it."""

# ruff: noqa: F811 - a fixture is asked for by its name
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator

import httpx
import pytest
from tests.access.people import PersonBrowser, RunningProvider, with_provider
from tests.support.application import (  # noqa: F401 - fixtures
    Api,
    TeamBrowser,
    api,
    api_on_both,
    as_problem,
    browse,
    logs,
    make_api,
)
from tests.support.processes import ROOT, free_port


@pytest.fixture(scope="session")
def provider_process() -> Iterator[RunningProvider]:
    port = free_port()
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.access.oidc_provider", str(port)],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    running = RunningProvider(f"http://127.0.0.1:{port}", process)
    deadline = time.monotonic() + 60
    while True:
        try:
            running.order()
            break
        except httpx.TransportError:
            assert process.poll() is None, "the provider did not start"
            assert time.monotonic() < deadline
            time.sleep(0.05)
    yield running
    process.terminate()
    process.wait()


@pytest.fixture
def provider(provider_process: RunningProvider) -> RunningProvider:
    """The provider, without orders and with a fresh key."""
    provider_process.order(rotate="first")
    provider_process.order()
    return provider_process


@pytest.fixture
def site(
    make_api: Callable[..., Api],
    database_url: str,
    provider: RunningProvider,
) -> Api:
    """The application with the provider, on SQLite, then on PostgreSQL."""
    return with_provider(make_api, database_url, provider.issuer)


@pytest.fixture
def small_site(
    make_api: Callable[..., Api],
    sqlite_url: str,
    provider: RunningProvider,
) -> Api:
    """The application with the provider, on SQLite alone."""
    return with_provider(make_api, sqlite_url, provider.issuer)


@pytest.fixture
def person(
    browse: Callable[..., TeamBrowser],
    provider: RunningProvider,
) -> Callable[[Api], PersonBrowser]:
    """Opens a browser for a person."""
    return lambda site: PersonBrowser(browse(site), provider)
