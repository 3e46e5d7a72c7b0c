"""A provider as a process, and people who sign in through it."""
# ruff: noqa: F811 - a fixture is asked for by its name

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any
from urllib.parse import parse_qs, urlsplit

import httpx
import pytest
from tests.access.oidc_provider import CLIENT_ID, CLIENT_SECRET
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


@dataclass
class RunningProvider:
    """The process, and how to give it orders."""

    issuer: str
    process: "subprocess.Popen[bytes]"

    def order(self, **orders: Any) -> int:
        """Set what it does from now on; return how often it was asked for its keys."""
        answer = httpx.post(f"{self.issuer}/control", json=orders)
        answer.raise_for_status()
        return int(answer.json()["asked_for_keys"])

    def visit(self, url: str) -> str:
        """Let a browser visit the provider; return where it is sent back to."""
        answer = httpx.get(url)
        assert answer.status_code == 302, answer.text
        return answer.headers["location"]


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


def with_provider(make: Callable[..., Api], url: str, issuer: str, **settings: Any) -> Api:
    return make(
        url,
        public_url="https://server.test",
        oidc_issuer=issuer,
        oidc_client_id=CLIENT_ID,
        oidc_client_secret=CLIENT_SECRET,
        oidc_name="Example University",
        **settings,
    )


@dataclass
class PersonBrowser:
    """A browser of a person: to the provider and back."""

    browser: TeamBrowser
    provider: RunningProvider

    def begin(self, back: str = "/my") -> str:
        """Press the button; return the address at the provider."""
        answer = self.browser.client.get("/sign-in/provider", params={"back": back})
        assert answer.status_code == 303, answer.text
        return str(answer.headers["location"])

    def come_back(self, to: str) -> Any:
        """Follow the provider's redirect to the site."""
        parts = urlsplit(to)
        return self.browser.client.get(f"{parts.path}?{parts.query}")

    def sign_in(self, back: str = "/my") -> Any:
        return self.come_back(self.provider.visit(self.begin(back)))

    def get(self, path: str) -> Any:
        return self.browser.get(path)

    def post(self, path: str, data: dict[str, Any], page: str) -> Any:
        return self.browser.post(path, data, page=page)

    @property
    def has_session(self) -> bool:
        return not (self.browser.client.cookies.get("__Host-session") or "v.").startswith("v.")


@pytest.fixture
def person(
    browse: Callable[..., TeamBrowser],
    provider: RunningProvider,
) -> Callable[[Api], PersonBrowser]:
    """Opens a browser for a person."""
    return lambda site: PersonBrowser(browse(site), provider)


def query_of(url: str) -> dict[str, str]:
    return {name: values[0] for name, values in parse_qs(urlsplit(url).query).items()}
