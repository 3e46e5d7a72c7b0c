"""People at a provider, and what their browsers carry."""

import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any
from urllib.parse import parse_qs, urlsplit

import httpx
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


def query_of(url: str) -> dict[str, str]:
    return {name: values[0] for name, values in parse_qs(urlsplit(url).query).items()}
