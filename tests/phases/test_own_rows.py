"""The rows of the team that signed in are marked for it alone, and no cache mixes visitors up."""

import re
from typing import TYPE_CHECKING, Any

import pytest
from starlette.testclient import TestClient
from tests.phases.browsing import visitor

if TYPE_CHECKING:
    from tests.phases.life import Life

BOARD = "/?phase=test"


def marked(page: str) -> list[str]:
    return re.findall(r'id="e-([0-9a-z]+)" class="own[ "]', page)


@pytest.fixture
def boarded(life: "Life") -> dict[str, str]:
    """An anonymous phase with one entry of each of two teams."""
    life.make_phase(split="plain", policy={"anonymous": True})
    ids = {who: life.submit(who, speed, "Net", "plain") for who, speed in _SPEEDS.items()}
    life.work()
    return ids


_SPEEDS = {"alpha": 1.0, "beta": 9.0}


def test_a_team_finds_its_row_under_its_pseudonym(life: "Life", boarded: dict[str, str]) -> None:
    names = {entry["submission_id"]: entry["team"] for entry in life.board()["entries"]}
    for who, rank in (("alpha", 1), ("beta", 2)):
        page = visitor(life, who).get(BOARD).text
        assert marked(page) == [boarded[who]]
        words = f"Your team stands here as {names[boarded[who]]}: one entry, rank {rank}."
        assert words in page
        assert page.count("Yours") == 1


def test_nobody_else_learns_whose_a_row_is(life: "Life", boarded: dict[str, str]) -> None:
    own = visitor(life, "alpha")
    before = life.client.get(BOARD)
    assert marked(own.get(BOARD).text) == [boarded["alpha"]]
    after = life.client.get(BOARD)
    assert after.text == before.text
    for page in (after.text, *(visitor(life, who).get(BOARD).text for who in _STRANGERS)):
        assert marked(page) == []
        assert "Your team stands" not in page
        assert "Yours" not in page
    for path in ("/export/board.csv?phase=test", "/api/v1/leaderboard?phase=test"):
        assert own.get(path).text == life.client.get(path).text, path


_STRANGERS = ("gamma", "organizer")


def test_what_a_team_sees_is_kept_for_it_alone(life: "Life", boarded: dict[str, str]) -> None:
    own, anybody = visitor(life, "alpha"), life.client
    mine, public = own.get(BOARD), anybody.get(BOARD)
    assert mine.headers["cache-control"] == "private, no-cache"
    assert public.headers["cache-control"] == "no-cache"
    assert public.headers["vary"] == "Cookie, Accept-Encoding"
    assert mine.headers["vary"] == "Cookie"
    assert mine.headers["etag"] != public.headers["etag"]

    def again(client: TestClient, answer: Any) -> int:
        return client.get(BOARD, headers={"If-None-Match": answer.headers["etag"]}).status_code

    assert (again(own, mine), again(anybody, public)) == (304, 304)
    assert (again(anybody, mine), again(own, public)) == (200, 200)
    assert (again(visitor(life, "beta"), mine), marked(public.text)) == (200, [])
