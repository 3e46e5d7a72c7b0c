"""Public answers are compressed; what holds a secret of one reader never is."""

import re
from typing import TYPE_CHECKING

import pytest
from tests.phases.browsing import visitor

if TYPE_CHECKING:
    from tests.phases.life import Life

PACKED = {"Accept-Encoding": "gzip", "Accept": "text/html"}
OF_ONE = ("/my", "/my/team", "/my/tokens", "/submit?phase=test", "/sign-in", "/organize", "/?q=x")


@pytest.mark.parametrize(
    "path", ["/", "/?phase=test", "/protocols/1.0", "/api", "/static/site.css"]
)
def test_what_is_public_is_compressed_for_who_takes_that(life: "Life", path: str) -> None:
    life.make_phase(split="plain")
    packed = life.client.get(path, headers=PACKED)
    plain = life.client.get(path, headers={**PACKED, "Accept-Encoding": "gzip;q=0, identity"})
    assert (packed.status_code, packed.headers["content-encoding"]) == (200, "gzip")
    assert "content-encoding" not in plain.headers
    assert packed.content == plain.content
    assert int(packed.headers["content-length"]) < len(plain.content) / 2
    assert "Accept-Encoding" in packed.headers["vary"]


@pytest.mark.parametrize("who", ["alpha", "organizer", None])
def test_a_page_with_a_secret_is_never_compressed(life: "Life", who: str | None) -> None:
    life.make_phase(split="plain")
    client = life.client if who is None else visitor(life, who)
    n_secrets = 0
    for path in OF_ONE:
        answer = client.get(path, headers=PACKED)
        has_secret = re.search('name="form_token"', answer.text) is not None
        n_secrets += has_secret
        if has_secret or who is not None:
            assert "content-encoding" not in answer.headers, path
    assert n_secrets


def test_an_answer_to_a_bearer_is_not_compressed(life: "Life") -> None:
    life.make_phase(split="plain")
    headers = {**PACKED, "Authorization": f"Bearer {life.tokens['organizer']}"}
    answer = life.client.get("/api/v1/organizer/audit", headers=headers)
    assert answer.status_code == 200
    assert len(answer.content) > 1024
    assert "content-encoding" not in answer.headers
