"""/tokens of the API and /my/tokens of the pages: a team looks after its own tokens."""

import re
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any

import pytest

from exceptiondrive_records.accounts.tokens import MAX_NEW_TOKENS_A_DAY

if TYPE_CHECKING:
    from tests.support.application import Api, TeamBrowser

Problem = Callable[[Any, int, str], dict[str, Any]]
Open = Callable[..., "TeamBrowser"]


def own_id(api: "Api", who: str = "alpha") -> str:
    return api.tokens[who].split("_")[2]


def test_a_team_lists_its_own_tokens_without_secrets(api_on_both: "Api") -> None:
    answer = api_on_both.get("/tokens", "alpha")
    assert [token["prefix"] for token in answer.json()] == [f"edk_s_{own_id(api_on_both)}"]
    assert api_on_both.tokens["alpha"] not in answer.text
    assert "digest" not in answer.text


def test_an_issued_token_works_with_its_scopes_alone(api_on_both: "Api") -> None:
    api = api_on_both
    until = (datetime.now(UTC) + timedelta(days=3)).isoformat()
    body = {"name": "CI", "scopes": ["submit"], "expires_at": until}
    issued = api.post("/tokens", "alpha", json=body)
    assert issued.status_code == 201
    assert issued.headers["cache-control"] == "no-store"
    api.tokens["ci"] = issued.json()["token"]
    assert api.submit("a", "ci").status_code == 202
    refused = api.get("/submissions", "ci")
    assert refused.status_code == 403
    assert "the scope 'read:own'; `exceptiondrive whoami` shows" in refused.json()["detail"]
    assert api.get("/tokens", "ci").status_code == 403


def test_the_default_is_to_submit_and_to_read(api: "Api") -> None:
    issued = api.post("/tokens", "alpha", json={"name": "laptop"}).json()
    assert issued["view"]["scopes"] == ["read:own", "submit"]


def test_no_token_gives_more_than_it_has(api: "Api", as_problem: Problem) -> None:
    body = {"name": "x", "scopes": ["organizer"]}
    as_problem(api.post("/tokens", "alpha", json=body), 403, "not_allowed")
    keeper = {"name": "keeper", "scopes": ["tokens"]}
    api.tokens["keeper"] = api.post("/tokens", "alpha", json=keeper).json()["token"]
    body = {"name": "x", "scopes": ["submit"]}
    as_problem(api.post("/tokens", "keeper", json=body), 403, "not_allowed")
    rotated = api.post(f"/tokens/{own_id(api)}/rotate", "keeper", json={})
    as_problem(rotated, 403, "not_allowed")


def test_no_token_makes_one_that_outlives_it(api_on_both: "Api", as_problem: Problem) -> None:
    api, scopes = api_on_both, ["submit", "read:own", "tokens"]
    end = (datetime.now(UTC) + timedelta(days=3)).replace(microsecond=0)
    body = {"name": "for three days", "scopes": scopes, "expires_at": end.isoformat()}
    own = api.post("/tokens", "alpha", json=body).json()
    api.tokens["brief"] = own["token"]

    made = api.post("/tokens", "brief", json={"name": "x"}).json()["view"]
    assert datetime.fromisoformat(made["expires_at"]) == end
    earlier = {"name": "x", "expires_at": (end - timedelta(days=1)).isoformat()}
    assert api.post("/tokens", "brief", json=earlier).status_code == 201
    later = {"name": "x", "expires_at": (end + timedelta(seconds=1)).isoformat()}
    refused = as_problem(api.post("/tokens", "brief", json=later), 403, "not_allowed")
    assert f"Your own token ends at {end:%Y-%m-%dT%H:%M:%S}Z" in refused["detail"]
    for token_id in (own_id(api), own["view"]["id"]):
        rotated = api.post(f"/tokens/{token_id}/rotate", "brief", json={}).json()["view"]
        assert datetime.fromisoformat(rotated["expires_at"]) == end


def test_rotating_keeps_the_old_token_for_a_while(api_on_both: "Api") -> None:
    api = api_on_both
    new = api.post(f"/tokens/{own_id(api)}/rotate", "alpha", json={"keep_days": 2})
    assert new.status_code == 201
    api.tokens["new"] = new.json()["token"]
    assert api.get("/me", "new").json()["scopes"] == api.get("/me", "alpha").json()["scopes"]
    ends = datetime.fromisoformat(api.get("/me", "alpha").json()["expires_at"])
    assert timedelta(days=1, hours=23) < ends - datetime.now(UTC) < timedelta(days=2, minutes=1)
    (line,) = api.get("/organizer/audit?action=token rotated", "organizer").json()
    successor = new.json()["view"]["id"]
    assert (line["subject"], line["detail"]) == (own_id(api), {"successor": successor})
    at_once = api.post(f"/tokens/{own_id(api)}/rotate", "new", json={"keep_days": 0})
    assert at_once.status_code == 201
    assert api.get("/me", "alpha").status_code == 401


def test_a_revoked_token_is_dead_at_once(api: "Api", as_problem: Problem) -> None:
    assert api.post(f"/tokens/{own_id(api)}/revoke", "alpha").json()["revoked_at"] is not None
    as_problem(api.get("/me", "alpha"), 401, "not_signed_in")


def test_tokens_are_made_and_revoked_only_so_often_a_day(api: "Api", as_problem: Problem) -> None:
    """Each leaves a row and an audit line for ever."""
    for _ in range(MAX_NEW_TOKENS_A_DAY - len(api.get("/tokens", "alpha").json())):
        made = api.post("/tokens", "alpha", json={"name": "x"})
        assert api.post(f"/tokens/{made.json()['view']['id']}/revoke", "alpha").status_code == 200
    refused = api.post("/tokens", "alpha", json={"name": "x"})
    assert "in 24 hours" in as_problem(refused, 409, "conflict")["detail"]
    assert api.post("/tokens", "beta", json={"name": "x"}).status_code == 201


@pytest.mark.parametrize("what", ["revoke", "rotate"])
def test_another_teams_token_is_not_there(api: "Api", as_problem: Problem, what: str) -> None:
    body: dict[str, Any] = {"json": {}} if what == "rotate" else {}
    for token_id in (own_id(api, "beta"), own_id(api, "organizer"), "nosuch00"):
        as_problem(api.post(f"/tokens/{token_id}/{what}", "alpha", **body), 404, "not_found")
    assert api.get("/me", "beta").status_code == 200


def test_who_belongs_to_no_team_has_none(api: "Api", as_problem: Problem) -> None:
    body = {"name": "o", "scopes": ["tokens"]}
    as_problem(api.get("/tokens", "organizer"), 403, "not_allowed")
    as_problem(api.post("/tokens", "organizer", json=body), 403, "not_allowed")


def test_scopes_are_told_one_by_one_and_each_is_kept_once(api: "Api", as_problem: Problem) -> None:
    def fields(scopes: list[str]) -> dict[str, str]:
        answer = api.post("/tokens", "alpha", json={"name": "x", "scopes": scopes})
        return dict(as_problem(answer, 400, "bad_request")["fields"])

    assert list(fields(["all"])) == ["scopes.0"]
    assert fields([]) == {"scopes": "must hold at least one"}
    twice = api.post("/tokens", "alpha", json={"name": "x", "scopes": ["read:own", "read:own"]})
    assert twice.json()["view"]["scopes"] == ["read:own"]


@pytest.mark.parametrize(
    "body", [{}, {"name": ""}, {"name": "x", "scopes": []}, {"name": "x", "scopes": ["all"]},
             {"name": "x", "expires_at": "2001-01-01T00:00:00Z"}, {"name": "x", "team": "beta"}]
)  # fmt: skip
def test_a_token_that_makes_no_sense_is_refused(
    api: "Api", as_problem: Problem, body: dict[str, Any]
) -> None:
    as_problem(api.post("/tokens", "alpha", json=body), 400, "bad_request")


def test_the_page_issues_a_token_and_shows_it_once(api: "Api", browse: Open) -> None:
    browser = browse(api, who="alpha")
    form = {"name": "cluster <1>", "scopes": ["submit", "read:own"], "days": "30"}
    page = browser.post("/my/tokens", form, page="/my/tokens")
    assert page.status_code == 200
    assert page.headers["cache-control"] == "no-store"
    shown = re.findall(r">(edk_s_\w{8}_\w{32}_\w{6})<", page.text)
    assert len(shown) == 1
    api.tokens["cluster"] = shown[0]
    assert api.get("/me", "cluster").json()["scopes"] == ["read:own", "submit"]
    assert shown[0] not in browser.get("/my/tokens").text
    assert "cluster &lt;1&gt;" in browser.get("/my/tokens").text


def test_the_page_rotates_and_revokes(api: "Api", browse: Open) -> None:
    browser = browse(api, who="alpha")
    rotated = browser.post(
        f"/my/tokens/{own_id(api)}/rotate", {"keep_days": "3"}, page="/my/tokens"
    )
    new = re.findall(r">(edk_s_\w{8}_\w{32}_\w{6})<", rotated.text)[0].split("_")[2]
    assert browser.post(f"/my/tokens/{new}/revoke", {}, page="/my/tokens").status_code == 303
    assert "revoked" in browser.get("/my/tokens").text
    beta = browser.post(f"/my/tokens/{own_id(api, 'beta')}/revoke", {}, page="/my/tokens")
    assert beta.status_code == 404
    browser.post(f"/my/tokens/{own_id(api)}/revoke", {}, page="/my/tokens")
    assert browser.get("/my/tokens").status_code == 303, "the session ends with its own token"


@pytest.mark.parametrize("days", ["-1", "1e3", "x", "99999", "٣"])
def test_days_on_the_page_are_a_plain_number(api: "Api", browse: Open, days: str) -> None:
    browser = browse(api, who="alpha")
    form = {"name": "x", "scopes": "submit", "days": days}
    assert browser.post("/my/tokens", form, page="/my/tokens").status_code == 400


@pytest.mark.parametrize("days", ["0", "3651", "000003650999999", "9" * 5000, "\u0663"])
def test_the_page_takes_a_number_of_days_that_can_be_meant(
    api: "Api", browse: Open, days: str
) -> None:
    browser = browse(api, who="alpha")
    form = {"name": "cluster", "scopes": ["submit"], "days": days}
    assert browser.post("/my/tokens", form, page="/my/tokens").status_code == 400


def test_after_a_refusal_the_page_of_tokens_keeps_what_was_typed(api: "Api", browse: Open) -> None:
    browser = browse(api, who="alpha")
    form = {"name": "cluster", "scopes": ["submit"], "days": "-4"}
    page = browser.post("/my/tokens", form, page="/my/tokens").text
    assert "Days until it expires: must be a whole number from 1 to 3,650." in page
    assert 'value="cluster"' in page
    assert 'value="-4"' in page
    rotate = f"/my/tokens/{own_id(api)}/rotate"
    page = browser.post(rotate, {"keep_days": "-4"}, page="/my/tokens").text
    assert "The old one works, more days: must be a whole number from 0 to" in page
    assert "A new token" in page, "the page of tokens again"


def test_whoever_revokes_a_token_is_told_what_it_made(
    api_on_both: "Api", browse: Callable[..., "TeamBrowser"]
) -> None:
    """What a thief made with a stolen token works on, also where a token between was revoked."""
    api = api_on_both
    every = {"scopes": ["submit", "read:own", "tokens"]}
    lost = api.post("/tokens", "alpha", json={"name": "lost", **every}).json()
    api.tokens["lost"] = lost["token"]
    between = api.post("/tokens", "lost", json={"name": "between", **every}).json()
    api.tokens["between"] = between["token"]
    door = api.post("/tokens", "between", json={"name": "door"}).json()
    own_name = api.get("/me", "alpha").json()["token_name"]
    assert lost["view"]["made_by"] == f"{own_name} (edk_s_{own_id(api)})"
    assert door["view"]["made_by"] == f"between ({between['view']['prefix']})"
    first = api.post(f"/tokens/{between['view']['id']}/revoke", "alpha").json()
    assert [one["name"] for one in first["still_work"]] == ["door"]

    browser = browse(api, who="alpha")
    page = " ".join(browser.get("/my/tokens").text.split())
    told = f"What was made with it works on: <b>door</b> (<code>{door['view']['prefix']}</code>)."
    assert told in page
    assert f'<td data-k="made by">lost ({lost["view"]["prefix"]})</td>' in page

    revoked = api.post(f"/tokens/{lost['view']['id']}/revoke", "alpha").json()
    assert revoked["revoked_at"] is not None
    assert [one["prefix"] for one in revoked["still_work"]] == [door["view"]["prefix"]]
    own = api.post(f"/tokens/{door['view']['id']}/revoke", "alpha").json()
    assert own["still_work"] == []


def test_a_team_reads_no_name_of_an_organizer_on_its_tokens(api: "Api") -> None:
    made = api.post("/organizer/teams/alpha/tokens", "organizer", json={"name": "handed"}).json()
    seen = {one["name"]: one["made_by"] for one in api.get("/tokens", "alpha").json()}
    assert seen["handed"] == "organizers"
    by_organizers = api.get("/organizer/teams/alpha/tokens", "organizer").json()
    name = api.get("/me", "organizer").json()["token_name"]
    assert {one["name"]: one["made_by"] for one in by_organizers}["handed"] == name
    assert made["view"]["made_by"] == name


def test_an_organizer_who_revokes_is_told_what_the_token_made(
    api: "Api", browse: Callable[..., "TeamBrowser"]
) -> None:
    door = api.post("/tokens", "alpha", json={"name": "door"}).json()["view"]
    browser = browse(api, who="organizer")
    asked = browser.get(f"/organize/tokens/{own_id(api)}/revoke").text
    assert f"door ({door['prefix']})" in asked
    assert "Tokens made with it keep working" in asked
    last = browser.get(f"/organize/tokens/{door['id']}/revoke").text
    assert "Tokens made with it keep working" not in last
    path = f"/organizer/tokens/{api.tokens['organizer'].split('_')[2]}/revoke"
    api.post("/organizer/teams/beta/tokens", "organizer", json={"name": "handed"})
    assert [one["name"] for one in api.post(path, "organizer").json()["still_work"]] == ["handed"]
