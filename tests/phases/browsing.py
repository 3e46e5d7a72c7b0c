"""A signed-in visitor of the pages, without a browser."""

import re
from typing import TYPE_CHECKING, Any

from starlette.testclient import TestClient

if TYPE_CHECKING:
    from tests.phases.life import Life

HTML = {"Accept": "text/html", "Origin": "https://server.test"}


def visitor(life: "Life", who: str) -> TestClient:
    """Somebody who signed in with the own token."""
    client = TestClient(life.client.app, base_url="https://server.test", follow_redirects=False)
    done = send(client, "/sign-in", {"token": life.tokens[who]}, page="/sign-in")
    assert done.status_code == 303
    return client


def send(client: TestClient, path: str, fields: dict[str, str], *, page: str) -> Any:
    """Send a form as a page offers it."""
    found = re.search(r'name="form_token" value="([0-9a-f]{64})"', client.get(page).text)
    assert found is not None, page
    return client.post(path, data={"form_token": found[1], **fields}, headers=HTML)
