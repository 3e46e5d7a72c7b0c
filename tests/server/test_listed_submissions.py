"""Lists of submissions: the records are asked as often for fifteen as for three."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import pytest
from tests.records.statements import statements

from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_server.web import services as of_site

if TYPE_CHECKING:
    from tests.support.application import Api, TeamBrowser

POLICIES = {
    "plain": {},
    "teams choose runs": {"run_choice": "team"},
    "one of each team": {"entries_shown": "chosen"},
    "private": {"entries_private": True},
    "frozen": {"freezes_at": "2026-01-01T00:00:00Z", "frozen_scores": "hidden"},
}


def submit(api: "Api", numbers: range) -> None:
    """Of three files two are scored, of every other method, and one waits."""
    for number in numbers:
        sent = api.submit(f"{number}", phase="many", method=f"Method {number // 2}")
        assert sent.status_code == 202, sent.text
        if number % 3:
            api.score(name := sent.json()["id"])
            if number % 2:
                assert api.get(f"/submissions/{name}?profile=true", "alpha").json()[
                    "awaits_profile"
                ]


def closes(api: "Api", *, is_now: bool) -> None:
    with api.database.write() as session:
        session.get_one(Phase, "many").closes_at = database_now(session) if is_now else None


@pytest.mark.parametrize("policy", POLICIES)
def test_a_list_asks_as_often_for_fifteen_submissions_as_for_three(
    api: "Api",
    browse: Callable[..., "TeamBrowser"],
    monkeypatch: pytest.MonkeyPatch,
    policy: str,
) -> None:
    monkeypatch.setattr(of_site, "MAX_AGE_S", 3600.0)  # a slow machine must not turn it in between
    api.phase("many", quota_per_day=100, policy=POLICIES[policy])
    team, organizer = browse(api), browse(api)
    assert team.sign_in("alpha").status_code == organizer.sign_in("organizer").status_code == 303
    lists: dict[str, Callable[[], str]] = {
        "API": lambda: api.get("/submissions?phase=many", "alpha").text,
        "page of the team": lambda: team.get("/my").text,
        "page of the organizers": lambda: organizer.get("/organize/submissions").text,
    }
    asked: dict[str, list[int]] = {name: [] for name in lists}
    for numbers in (range(3), range(3, 15)):
        closes(api, is_now=False)
        submit(api, numbers)
        closes(api, is_now=policy == "private")
        for name, look in lists.items():
            look()
            with statements(api.services.database) as sent:
                text = look()
            assert f"Method {numbers[-1] // 2}" in text, text
            asked[name].append(len(sent))
    assert {name: few for name, (few, _) in asked.items()} == {
        name: many for name, (_, many) in asked.items()
    }
