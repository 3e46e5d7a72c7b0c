"""The pages of edits: what a team says of a submission, its history, its own file again."""

import re
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any

import pytest
from markupsafe import escape
from sqlalchemy import insert, update
from tests.server.nasty_strings import NASTY, UNSHOWABLE
from tests.support.databases import wait_until_it_waits
from tests.support.documents import digest_of

from exceptiondrive_records.accounts.tables import Token
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.entries.selection import publish
from exceptiondrive_records.notifications.inbox import list_notifications
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.submissions.submissions import withdraw
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_schemas.api.phase_settings import PhasePolicy
from exceptiondrive_server.web import browser_session

if TYPE_CHECKING:
    from tests.support.application import Api, TeamBrowser

Problem = Callable[[Any, int, str], dict[str, Any]]
Browse = Callable[..., "TeamBrowser"]


def signed_in(api: "Api", browse: Browse, who: str = "alpha") -> "TeamBrowser":
    return browse(api, who=who)


def test_the_form_shows_what_is_said_and_saves_what_is_typed(api: "Api", browse: Browse) -> None:
    one = api.submit("a", method="Planer", paper_url="https://example.org/p").json()["id"]
    browser = signed_in(api, browse)
    page = f"/submissions/{one}/edit"
    assert 'value="https://example.org/p"' in browser.get(page).text
    typed = {
        "method": "Planner",
        "description": "Two words",
        "paper_url": "",
        "code_url": "https://example.org/c",
        "fact_type": "vla",
        "fact_sensors": ["lidar", "radar"],
        "fact_parameters_millions": "7000",
        "fact_hardware": "one <b>card</b>",
    }
    answer = browser.post(page, typed, page=page)
    assert (answer.status_code, answer.headers["location"]) == (303, f"/submissions/{one}")
    seen = api.get(f"/submissions/{one}", "alpha").json()
    assert (seen["method"], seen["links"]) == (
        "Planner",
        {"paper": None, "code": "https://example.org/c"},
    )
    assert seen["facts"]["sensors"] == ["lidar", "radar"]
    assert seen["facts"]["parameters_millions"] == 7000
    again = browser.get(page).text
    assert "<b>card</b>" not in again
    assert "one &lt;b&gt;card&lt;/b&gt;" in again
    assert "Planer" in again, "the history says what it was before"
    assert again.count("checked") == 2


def test_the_history_of_edits_is_shown_to_who_may_read_submissions_alone(
    api: "Api", browse: Browse
) -> None:
    one = api.submit("a", method="Planer").json()["id"]
    api.request("PATCH", f"/submissions/{one}", "alpha", json={"method": "Planner"})
    body = {"name": "ci", "scopes": ["submit"]}
    api.tokens["ci"] = api.post("/tokens", "alpha", json=body).json()["token"]
    assert api.get(f"/submissions/{one}/edits", "ci").status_code == 403
    page = f"/submissions/{one}/edit"
    assert "Changes so far" in signed_in(api, browse).get(page).text
    shown = signed_in(api, browse, "ci").get(page)
    assert (shown.status_code, 'value="Planner"' in shown.text) == (200, True)
    assert "Changes so far" not in shown.text
    assert "Planer" not in shown.text


def test_a_refused_edit_keeps_what_was_typed(api: "Api", browse: Browse) -> None:
    one = api.submit("a").json()["id"]
    browser = signed_in(api, browse)
    page = f"/submissions/{one}/edit"
    typed = {"method": "FREEZE", "description": "mine", "fact_time_per_sample_s": "0.2"}
    answer = browser.post(page, typed, page=page)
    assert answer.status_code == 400
    assert "reserved for the reference rows" in answer.text
    assert 'value="FREEZE"' in answer.text
    assert 'value="0.2"' in answer.text
    wrong = browser.post(page, {**typed, "method": "M", "fact_map": "moon"}, page=page)
    assert "Map: must be one of those offered" in wrong.text


def test_a_name_of_another_method_asks_before_an_entry_goes(
    api: "Api", as_problem: Problem, browse: Browse
) -> None:
    mine = api.submit("a", method="Brake gently").json()["id"]
    other = api.submit("b", method="brake gently").json()["id"]
    for each in (mine, other):
        api.score(each)
    token = {"name": "ci", "scopes": ["submit"]}
    api.tokens["ci"] = api.post("/tokens", "alpha", json=token).json()["token"]
    for who, named in (("alpha", f'{mine} (HCC 50.00) of "Brake gently"'), ("ci", "an entry of")):
        renamed = {"method": "brake gently"}
        answer = api.request("PATCH", f"/submissions/{mine}", who, json=renamed)
        assert f"It replaces {named}" in as_problem(answer, 409, "not_confirmed")["detail"]
    browser, page = signed_in(api, browse), f"/submissions/{mine}/edit"
    assert 'name="replace"' not in browser.get(page).text
    asked = browser.post(page, renamed, page=page)
    assert (asked.status_code, "It replaces" in asked.text) == (409, True)
    assert 'name="replace"' in asked.text
    assert api.get(f"/submissions/{mine}", "alpha").json()["method"] == "Brake gently"
    assert browser.post(page, {**renamed, "replace": "yes"}, page=page).status_code == 303
    assert api.get(f"/submissions/{mine}", "alpha").json()["replaced_by"] == other


@pytest.mark.parametrize("freezes_at", ["2026-01-01T00:00:00Z", "between"])
def test_two_methods_whose_scores_are_kept_back_become_one_only_when_asked(
    api: "Api", as_problem: Problem, browse: Browse, freezes_at: str
) -> None:
    """Nobody is told which of the two stands, nor is it told by whether it is asked."""
    policy = PhasePolicy(frozen_scores="hidden", run_choice="team")
    api.phase("frozen", policy=policy)
    sent = {"phase": "frozen"}
    one = api.submit("a", method="One", **sent).json()["id"]
    with api.database.write() as session:
        at = database_now(session) if freezes_at == "between" else freezes_at
        phase = session.get_one(Phase, "frozen")
        phase.policy = PhasePolicy.model_validate({**policy.model_dump(), "freezes_at": at})
    two = api.submit("b", method="Two", **sent).json()["id"]
    for each, hcc in ((one, 0.5), (two, 0.25)):
        api.score(each, hcc=hcc)
    for renamed, to in ((one, "Two"), (two, "One")):
        answer = api.request("PATCH", f"/submissions/{renamed}", "alpha", json={"method": to})
        told = as_problem(answer, 409, "not_confirmed")["detail"]
        assert "another run of your team" in told
        assert not any(word in told for word in (one, two, "HCC"))
    said = api.request("PATCH", f"/submissions/{one}", "alpha", json={"description": "Said."})
    assert said.status_code == 200, "this brings nothing together"
    browser, page = signed_in(api, browse), f"/submissions/{one}/edit"
    asked = browser.post(page, {"method": "Two"}, page=page)
    assert (asked.status_code, 'name="replace"' in asked.text) == (409, True)
    assert browser.post(page, {"method": "Two", "replace": "yes"}, page=page).status_code == 303
    said = api.request("PATCH", f"/submissions/{one}", "alpha", json={"description": "More."})
    assert said.status_code == 200, "they are one already"


def test_a_private_run_brings_no_two_together_unasked_whose_scores_are_kept_back(
    api: "Api", as_problem: Problem
) -> None:
    hides = PhasePolicy(
        frozen_scores="hidden",
        run_choice="team",
        entries_private=True,
        freezes_at=datetime(2026, 1, 1, tzinfo=UTC),
    )
    api.phase("frozen", policy=hides)
    private, *public = (
        api.submit(each, phase="frozen", method=method).json()["id"]
        for each, method in (("a", "One"), ("b", "One"), ("c", "Two"))
    )
    for each in (private, *public):
        api.score(each)
    for each in public:
        assert api.post(f"/submissions/{each}/publish", "alpha").status_code == 200
    answer = api.request("PATCH", f"/submissions/{private}", "alpha", json={"method": "Two"})
    assert "another run of your team" in as_problem(answer, 409, "not_confirmed")["detail"]
    answer = api.request("PATCH", f"/submissions/{private}", "alpha", json={"method": "Three"})
    assert answer.status_code == 200, "its own runs stay together"


def test_a_public_run_is_named_before_another_takes_its_place(
    api: "Api", as_problem: Problem, browse: Browse
) -> None:
    api.phase("quiet", policy=PhasePolicy(entries_private=True))
    first, second = (api.submit(one, phase="quiet").json()["id"] for one in "ab")
    for each in (first, second):
        api.score(each)
    address = f"/submissions/{second}/publish"
    assert api.post(f"/submissions/{first}/publish", "alpha").status_code == 200
    told = as_problem(api.post(address, "alpha"), 409, "not_confirmed")["detail"]
    browser, page = signed_in(api, browse), f"/submissions/{second}"
    asked = browser.post(address, {}, page=page)
    assert (asked.status_code, str(escape(told)) in asked.text) == (409, True)
    assert not api.get(page, "alpha").json()["is_published"]
    assert browser.post(address, {"replace": "yes"}, page=page).status_code == 303
    assert api.get(f"/submissions/{first}", "alpha").json()["replaced_by"] == second
    assert api.post(f"/submissions/{first}/unpublish", "alpha").status_code == 200
    assert api.post(f"{address}?replace=true", "alpha").status_code == 200, "twice is once"


def test_a_public_run_is_named_however_many_private_ones_came_after_it(
    api: "Api", as_problem: Problem
) -> None:
    api.phase("quiet", policy=PhasePolicy(entries_private=True))
    first, second = (api.submit(one, phase="quiet").json()["id"] for one in "ab")
    for each in (first, second):
        api.score(each)
    assert api.post(f"/submissions/{first}/publish", "alpha").status_code == 200
    with api.database.write() as session:
        one = session.get_one(Submission, second)
        same = {each.key: getattr(one, each.key) for each in Submission.__mapper__.column_attrs}
        later = [
            {
                **same,
                "id": f"later{at}",
                "file_digest": f"sha256:{at}",
                "received_at": one.received_at + timedelta(seconds=at),
            }
            for at in range(1, 251)
        ]
        session.execute(insert(Submission), later)
    told = api.post(f"/submissions/{second}/publish", "alpha")
    assert f"It replaces {first} (HCC 50.00)" in as_problem(told, 409, "not_confirmed")["detail"]


def test_of_two_that_are_published_at_one_moment_the_later_is_asked_about(
    api_on_both: "Api", as_problem: Problem
) -> None:
    api = api_on_both
    api.phase("quiet", policy=PhasePolicy(entries_private=True))
    first, second = (api.submit(one, phase="quiet").json()["id"] for one in "ab")
    for each in (first, second):
        api.score(each)
    with ThreadPoolExecutor() as pool:
        with api.database.write() as session:
            publish(session, first, actor="test")
            session.flush()
            other = pool.submit(api.post, f"/submissions/{second}/publish", "alpha")
            wait_until_it_waits(api.database, other.done)
        as_problem(other.result(), 409, "not_confirmed")


def test_what_is_withdrawn_at_this_moment_is_told_as_no_action_of_organizers(
    api_on_both: "Api",
) -> None:
    api = api_on_both
    one = api.submit("a").json()["id"]
    with ThreadPoolExecutor() as pool:
        with api.database.write() as session:
            withdraw(session, one, actor="test")
            session.flush()
            other = pool.submit(api.post, f"/submissions/{one}/withdraw", "organizer")
            wait_until_it_waits(api.database, other.done)
        assert other.result().json()["status"] == "withdrawn"
    with api.database.read() as session:
        assert list_notifications(session, api.team_ids["alpha"]) == []


def test_another_teams_edit_and_file_are_not_found(api: "Api", browse: Browse) -> None:
    one = api.submit("a").json()["id"]
    other = signed_in(api, browse, "beta")
    for page in (f"/submissions/{one}/edit", f"/submissions/{one}/file"):
        assert other.get(page).status_code == 404
    sent = other.send(f"/submissions/{one}/edit", {**other.form("/my"), "method": "Mine"})
    assert sent.status_code == 404
    assert api.get(f"/submissions/{one}", "alpha").json()["method"] == "Planner"


def test_an_edit_needs_the_token_of_the_form(api: "Api", browse: Browse) -> None:
    one = api.submit("a").json()["id"]
    browser = signed_in(api, browse)
    assert browser.send(f"/submissions/{one}/edit", {"method": "Mine"}).status_code == 403


def test_facts_travel_with_the_upload_form(api: "Api", browse: Browse) -> None:
    browser = signed_in(api, browse)
    answer = browser.submit("a", fact_type="rule", fact_sensors=["lidar", "gnss_imu"])
    assert answer.status_code == 303, answer.text
    one = answer.headers["location"].rsplit("/", 1)[1]
    facts = api.get(f"/submissions/{one}", "alpha").json()["facts"]
    assert (facts["type"], facts["sensors"]) == ("rule", ["lidar", "gnss_imu"])
    wrong = browser.submit("b", fact_parameters_millions="many", accept="text/html")
    assert wrong.status_code == 400
    assert "Parameters in millions: must be a number" in wrong.text


def test_what_was_sent_comes_back_bit_by_bit_to_its_team_alone(
    api: "Api", as_problem: Problem, browse: Browse
) -> None:
    content = b"\x1f\x8b any bytes at all \x00\xff"
    for data, suffix in ((content, ".json.gz"), (b"{}", ".json")):
        one = api.submit(data, method=f'"; filename=evil{suffix}').json()["id"]
        answer = api.get(f"/submissions/{one}/file", "alpha")
        assert answer.content == data
        assert answer.headers["etag"] == f'"{digest_of(data)}"'
        asks = {"If-None-Match": answer.headers["etag"]}
        again = api.get(f"/submissions/{one}/file", "alpha", headers=asks)
        assert (again.status_code, again.content) == (304, b"")
        as_problem(api.get(f"/submissions/{one}/file", "beta", headers=asks), 404, "not_found")
        name = f"exceptiondrive-{one}{suffix}"
        assert answer.headers["content-disposition"] == f'attachment; filename="{name}"'
        assert answer.headers["x-content-type-options"] == "nosniff"
        as_problem(api.get(f"/submissions/{one}/file"), 401, "not_signed_in")
        as_problem(api.get(f"/submissions/{one}/file", "beta"), 404, "not_found")
        as_problem(api.get(f"/submissions/{one}/file", "organizer"), 403, "not_allowed")
        page = signed_in(api, browse).get(f"/submissions/{one}/file")
        assert page.content == data


def test_nasty_facts_are_inert_or_refused(api: "Api", as_problem: Problem, browse: Browse) -> None:
    one = api.submit("a").json()["id"]
    browser = signed_in(api, browse)
    for text in NASTY.values():
        change = {"facts": {"hardware": text, "type": "other", "type_note": text[:60]}}
        assert api.request("PATCH", f"/submissions/{one}", "alpha", json=change).is_success
        page = browser.get(f"/submissions/{one}/edit").text
        assert escape(text) in page
        assert "<" not in text or text not in page
    for text in UNSHOWABLE.values():
        change = {"facts": {"hardware": text.strip() + "\u202e"}}
        as_problem(
            api.request("PATCH", f"/submissions/{one}", "alpha", json=change), 400, "bad_request"
        )


def test_the_entry_page_tells_facts_and_when_they_changed(
    api: "Api", browse: Browse, make_entry: Callable[..., Any]
) -> None:
    one = api.submit("a").json()["id"]
    api.score(one)
    api.publish(make_entry("Planner", submission_id=one))
    page = f"/entries/{one}"
    assert "The method" not in browse(api).get(page).text
    change = {"facts": {"type": "vla", "hardware": "<b>card</b>", "map": "hd"}}
    edited = api.request("PATCH", f"/submissions/{one}", "alpha", json=change).json()["edited_at"]
    text = browse(api).get(page).text
    assert "&lt;b&gt;card&lt;/b&gt;" in text
    assert "HD map" in text
    assert f'changed what it says of this entry on<time datetime="{edited[:19]}Z"' in re.sub(
        r"\s+<", "<", text
    )
    api.request("PATCH", f"/submissions/{one}", "alpha", json={"method": "Later"})
    assert "Later" not in browse(api).get(page).text, (
        "the board keeps the name it was published with"
    )


def test_the_page_says_who_can_take_a_withdrawal_back(api: "Api", browse: Browse) -> None:
    one = api.submit("a").json()["id"]
    said = " ".join(signed_in(api, browse).get(f"/submissions/{one}").text.split())
    assert "Only an organizer can undo this, and nobody once scores that were kept back" in said


def test_a_token_that_is_revoked_once_its_form_is_read_withdraws_nothing(
    api: "Api", browse: Browse, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before the transaction begins; what is revoked while the form comes is seen when it is read."""
    one, look = api.submit("a").json()["id"], browser_session.signed_in_or_none
    browser = signed_in(api, browse)
    page = f"/submissions/{one}"
    token = browser.form_token(page)

    def revoked_afterwards(*asked: Any) -> Any:
        found = look(*asked)
        with api.database.write() as session:
            mine = update(Token).where(Token.team_id == api.team_ids["alpha"])
            session.execute(mine.values(revoked_at=database_now(session)))
        return found

    monkeypatch.setattr(browser_session, "signed_in_or_none", revoked_afterwards)
    answer = browser.client.post(
        f"{page}/withdraw", data={"form_token": token}, headers={"Origin": browser.origin}
    )
    assert answer.status_code == 403
    assert api.get(page, "organizer").json()["status"] != "withdrawn"
