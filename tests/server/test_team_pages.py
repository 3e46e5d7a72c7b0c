"""GET and POST /submit, GET /my, GET /submissions/{id}, its events, and withdrawing on its page."""

import re
from collections.abc import Callable
from datetime import timedelta
from typing import TYPE_CHECKING, Any, Literal

import pytest
from sqlalchemy import select, update

from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.phases.changes import update_phase
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.work.tables import BoardRequest, Profile, WorkState
from exceptiondrive_schemas.api.phase_settings import PhaseChange
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.faults import CheckReport, Fault, FaultCode, FaultGroup
from exceptiondrive_schemas.file_profile import FileProfile

if TYPE_CHECKING:
    from tests.support.application import Api, TeamBrowser

Open = Callable[..., "TeamBrowser"]


@pytest.fixture
def alpha(api: "Api", browse: Open) -> "TeamBrowser":
    """A browser in which team Alpha signed in."""
    return browse(api, who="alpha")


REPORT = CheckReport(
    challenge=PLANNING.id,
    split="sample",
    n_predictions=3,
    digest="sha256:0",
    size_bytes=3,
    faults=(
        FaultGroup(
            code=FaultCode.WRONG_WAYPOINT_COUNT,
            message="Wrong number of waypoints: write 6 of them.",
            count=1234,
            examples=(
                Fault(
                    path="$.predictions[2].edited",
                    sample_id="s3",
                    expected="6 waypoints",
                    got="<b>5</b>",
                    hint="cut the horizon: `convert --truncate`",
                ),
            ),
        ),
    ),
)


def test_the_form_is_for_teams_alone(api: "Api", browse: Open, alpha: "TeamBrowser") -> None:
    stranger = browse(api).get("/submit").text
    assert "data-upload" not in stranger
    assert "/sign-in?back=/submit" in stranger
    assert "data-upload" in alpha.get("/submit").text
    assert 'action="/submit?phase=dev"' in alpha.get("/submit?phase=dev").text
    organizer = browse(api, who="organizer")
    assert "data-upload" not in organizer.get("/submit").text


def test_the_form_shows_what_is_left_and_when_it_begins_anew(alpha: "TeamBrowser") -> None:
    assert "5 of 5 left today" in alpha.get("/submit").text
    alpha.submit("a")
    page = alpha.get("/submit").text
    assert "4 of 5 left today" in page
    assert "up to 20 faulty files more today" in page
    assert "file costs no quota, up to 20 a day for each team" in " ".join(page.split())
    assert "00:00 UTC" in page


def test_an_upload_leads_to_its_page_and_is_the_one_that_the_api_shows(
    api_on_both: "Api", browse: Open
) -> None:
    browser = browse(api_on_both, who="alpha")
    answer = browser.submit("content", description="D\nE", code_url="https://code.test/x")
    assert answer.status_code == 303
    submission_id = answer.headers["location"].removeprefix("/submissions/")
    shown = api_on_both.get(f"/submissions/{submission_id}", "alpha").json()
    assert (shown["method"], shown["description"]) == ("Planner", "D\nE")
    assert shown["links"]["code"] == "https://code.test/x"
    page = browser.get(answer.headers["location"])
    assert page.status_code == 200
    assert page.headers["cache-control"] == "no-store"
    assert shown["file_digest"] in page.text
    assert '<p class="lede wraps">D\nE</p>' in page.text


SLOW = FileProfile(
    source_speed_mps=1.0,
    recorded_speed_mps=8.0,
    standing_sources=0.25,
    standing_edited=0.5,
    equal_pairs=0.125,
    longer_sources=0.75,
    source_l2_m=9.9,
    source_l2_1s_m=3.0,
    source_l2_2s_m=8.0,
    source_l2_3s_m=15.5,
    median_source_l2_m=9.5,
)


def test_the_page_of_a_scored_file_says_what_it_looks_like(
    api: "Api", alpha: "TeamBrowser"
) -> None:
    place = alpha.submit("a").headers["location"]
    report = REPORT.model_copy(update={"faults": (), "profile": SLOW})
    api.score(place.removeprefix("/submissions/"))
    with api.database.write() as session:  # the board is there: the page waits for the file alone
        session.execute(update(BoardRequest).values(state=WorkState.DONE))
    waiting = " ".join(alpha.get(place).text.split())
    assert "This is being computed, after the scores of all waiting files" in waiting
    assert 'data-again-s="2"' in waiting
    api.describe(report)
    page = " ".join(alpha.get(place).text.split())
    assert "What the file looks like" in page
    assert "This is being computed" not in page
    assert "data-again-s" not in page
    assert "The sources look too slow: median 1.00 m/s, recorded 8.00 m/s." in page
    for label, words in SLOW.lines:
        assert f"<dt>{label[0].upper()}{label[1:]}</dt><dd>{words}</dd>" in page
    assert "Faults" not in page


def test_the_form_says_what_a_later_run_replaces_and_the_page_by_what(
    api: "Api", alpha: "TeamBrowser"
) -> None:
    assert "replaces the earlier one" not in alpha.get("/submit").text
    first, second = (alpha.submit(text).headers["location"] for text in ("a", "b"))
    api.score(first.removeprefix("/submissions/"))
    form = " ".join(alpha.get("/submit").text.split())
    assert "A later run of a method replaces the earlier one" in form
    assert re.search(rf'<li>\s*[^<]+: <a href="{first}">Planner</a>', form)  # phase, then entries
    assert (
        "(because it answers fewer than 99 % of the samples, say), you are asked before anything counts"
        in form
    )
    api.score(second.removeprefix("/submissions/"), hcc=0.1)
    form = alpha.get("/submit").text
    assert f'<a href="{second}">' in form
    assert f'<a href="{first}">' not in form
    replaced_by = second.removeprefix("/submissions/")
    assert f'<a href="{second}">{replaced_by}</a> takes its place' in alpha.get(first).text
    shown = api.get(f"/submissions/{first.removeprefix('/submissions/')}", "alpha").json()
    assert shown["replaced_by"] == replaced_by


@pytest.mark.parametrize("visibility", ["archived", "hidden"])
def test_the_form_names_what_stands_where_something_can_be_sent(
    api: "Api", alpha: "TeamBrowser", visibility: Literal["archived", "hidden"]
) -> None:
    api.phase("ended")
    submission_id = api.submit("a", phase="ended").json()["id"]
    api.score(submission_id)
    assert f'<a href="/submissions/{submission_id}">' in alpha.get("/submit").text
    with api.database.write() as session:
        update_phase(session, "ended", PhaseChange(visibility=visibility), actor="test")
    form = alpha.get("/submit")
    assert form.status_code == 200
    assert "data-upload" in form.text
    assert f'<a href="/submissions/{submission_id}">' not in form.text


def test_the_same_bytes_again_lead_to_the_first_page_and_say_so(alpha: "TeamBrowser") -> None:
    first = alpha.submit("a").headers["location"]
    again = alpha.submit("a").headers["location"]
    assert again == f"{first}?again=1"
    assert "no quota was spent" in alpha.get(again).text


def test_a_spent_quota_is_a_page_with_the_time_to_wait(api: "Api", alpha: "TeamBrowser") -> None:
    for number in range(5):
        assert alpha.submit(f"file {number}").status_code == 303
    form = {"phase": "dev", "method": "P", **alpha.form("/submit")}
    answer = alpha.send("/submit", form, accept="text/html", files={"file": ("f", b"x")})
    assert answer.status_code == 429
    assert int(answer.headers["retry-after"]) > 0
    assert "Your team has used its 5 submissions of today" in answer.text
    problem = alpha.send("/submit", form, files={"file": ("f", b"x")}).json()
    assert problem["code"] == "quota_exceeded"


@pytest.mark.row("I25")
def test_a_forged_or_stale_upload_keeps_nothing(api: "Api", alpha: "TeamBrowser") -> None:
    form = {"phase": "dev", "method": "P"}
    files = {"file": ("f", b"x")}
    assert alpha.send("/submit", form, files=files).status_code == 403
    assert alpha.send("/submit", {**form, "form_token": "0" * 64}, files=files).status_code == 403
    good = {**form, **alpha.form("/submit")}
    far = alpha.client.post(
        "/submit", data=good, files=files, headers={"Origin": "https://evil.test"}
    )
    assert far.status_code == 403
    assert alpha.fresh().send("/submit", good, files=files).status_code == 303
    assert api.get("/submissions", "alpha").json()["submissions"] == []


@pytest.mark.parametrize("fields", [{"method": None}, {"phase": "no-such"}, {"more": "x"}])
def test_a_wrong_field_is_named(alpha: "TeamBrowser", fields: dict[str, Any]) -> None:
    answer = alpha.submit("a", **fields)
    assert answer.status_code in (400, 404)
    assert answer.json()["code"] in ("bad_request", "not_found")


def test_an_upload_that_is_too_large_is_refused_as_by_the_api(alpha: "TeamBrowser") -> None:
    assert alpha.submit(b"x" * 200_000).json()["code"] == "upload_too_large"


def test_the_api_takes_no_form_token(api: "Api") -> None:
    assert api.submit("a", form_token="x").status_code == 400


def test_a_token_that_may_only_read_sees_all_and_changes_nothing(api: "Api", browse: Open) -> None:
    made = api.post("/tokens", "alpha", json={"name": "reader", "scopes": ["read:own"]})
    api.tokens["reader"] = made.json()["token"]
    submission_id = api.submit("a").json()["id"]
    reader = browse(api, who="reader")
    assert "data-upload" not in reader.get("/submit").text
    page = reader.get(f"/submissions/{submission_id}")
    assert page.status_code == 200
    assert "/withdraw" not in page.text
    token = reader.form("/my")
    files = {"file": ("f", b"x")}
    form = {"phase": "dev", "method": "P", **token}
    assert reader.send("/submit", form, files=files).status_code == 403
    assert reader.send(f"/submissions/{submission_id}/withdraw", token).status_code == 403
    assert reader.get("/my/tokens").status_code == 403


def test_a_token_that_may_only_submit_is_led_to_where_it_does_and_finds_the_way_out(
    api: "Api", browse: Open
) -> None:
    api.tokens["ci"] = api.post(
        "/tokens", "alpha", json={"name": "ci", "scopes": ["submit"]}
    ).json()["token"]
    ci = browse(api)
    led = ci.get(ci.sign_in("ci").headers["location"])
    assert (led.status_code, led.headers["location"]) == (303, "/submit")
    assert "The server has submission" not in ci.get("/submit").text
    own = ci.submit("a").headers["location"]
    for page in (
        own,
        ci.post(f"{own}/edit", {"method": "M"}, page=f"{own}/edit").headers["location"],
    ):
        shown = ci.get(ci.get(page).headers["location"])
        assert shown.status_code == 200
        assert f"The server has submission <code>{own.rpartition('/')[2]}</code>" in shown.text
    theirs = api.submit("b", "beta").json()["id"]
    assert ci.get(f"/submit?sent={theirs}").status_code == 404
    assert 'href="/sign-in">Sign out' in ci.get("/submit").text
    refused = ci.get("/my/notices")
    assert (refused.status_code, 'href="/sign-in"' in refused.text) == (403, True)
    assert "With the token “ci”." in ci.get("/sign-in").text
    assert ci.post("/sign-out", {}, page="/sign-in").headers["location"] == "/"
    assert "You are signed in" not in ci.get("/sign-in").text


def test_a_token_is_revoked_by_a_second_step_that_says_what_follows(
    api: "Api", alpha: "TeamBrowser"
) -> None:
    api.post("/tokens", "alpha", json={"name": "cluster", "scopes": ["submit"]})
    rows = alpha.get("/my/tokens").text.split("<tr")[2:]
    other, own = sorted(rows, key=lambda row: "you signed in with it" in row)
    for row in (other, own):
        opened = row.split('<details class="danger">')[1]
        assert "It stops working at once, for good." in opened
        assert "/revoke" in opened
    assert "you are signed out too" in own
    assert "you are signed out too" not in other


def test_a_disqualified_team_is_offered_no_form_of_the_phase(
    api: "Api", alpha: "TeamBrowser"
) -> None:
    assert '<button class="btn pri">Submit</button>' in alpha.get("/submit").text
    why = {"reason": "The file was copied."}
    assert api.post("/organizer/teams/alpha/disqualify", "organizer", json=why).status_code == 201
    page = alpha.get("/submit").text
    assert "Your team is disqualified here since" in page
    assert 'value="dev" disabled' in " ".join(page.split())
    assert '<button class="btn pri">Submit</button>' not in page
    assert "left today" not in page
    own = " ".join(alpha.get("/my").text.split())
    assert "nothing: your team is disqualified here since" in own
    assert 'data-k="left today"' not in own


def test_my_lists_the_teams_own_with_status_and_place(api: "Api", alpha: "TeamBrowser") -> None:
    mine, theirs = api.submit("a").json()["id"], api.submit("b", "beta").json()["id"]
    page = alpha.get("/my").text
    assert f"/submissions/{mine}" in page
    assert theirs not in page
    assert "next in line; no worker can score it right now" in page
    assert f'data-live="/submissions/{mine}/events' in page
    api.score(mine)
    page = alpha.get("/my").text
    assert ">scored<" in page
    assert "/events" not in page


def test_my_goes_on_to_older_submissions(
    api: "Api", alpha: "TeamBrowser", monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("exceptiondrive_server.submissions.pages.SHOWN", 1)
    first, second = (api.submit(text).json()["id"] for text in "ab")
    page = alpha.get("/my").text
    assert first not in page
    assert f"/my?after={second}" in page
    assert f"/submissions/{first}" in alpha.get(f"/my?after={second}").text


def test_organizers_see_every_teams_submissions(api: "Api", browse: Open) -> None:
    ids = [api.submit("a").json()["id"], api.submit("b", "beta").json()["id"]]
    organizer = browse(api, who="organizer")
    page = organizer.get("/my").text
    assert all(one in page for one in ids)
    assert organizer.get(f"/submissions/{ids[1]}").status_code == 200


@pytest.mark.parametrize("path", ["", "/events", "/withdraw"])
def test_another_teams_submission_is_not_there(api: "Api", alpha: "TeamBrowser", path: str) -> None:
    theirs = api.submit("b", "beta").json()["id"]
    told = []
    for submission_id in (theirs, "nosuchsubmission"):
        address = f"/submissions/{submission_id}{path}"
        form = alpha.form("/my")
        answer = alpha.send(address, form) if path == "/withdraw" else alpha.get(address, "*/*")
        assert answer.status_code == 404
        told.append(answer.json()["detail"].replace(submission_id, "X"))
    assert told[0] == told[1]
    assert api.get(f"/submissions/{theirs}", "beta").json()["status"] == "received"
    assert alpha.get(f"/my?after={theirs}").status_code == 400


def test_the_page_of_a_rejected_file_lists_its_faults_safely(
    api: "Api", alpha: "TeamBrowser"
) -> None:
    submission_id = api.submit("a").json()["id"]
    api.reject(submission_id, REPORT.model_copy(update={"profile": FileProfile()}))
    page = alpha.get(f"/submissions/{submission_id}").text
    assert "What the file looks like" not in page, "of no whole trajectory there is nothing to say"
    for words in ("1,234 faults", "wrong_waypoint_count", "$.predictions[2].edited", "6 waypoints",
                  "cut the horizon: <code>convert --truncate</code>", "&lt;b&gt;5&lt;/b&gt;", "1,233 more of this kind",
                  "No quota was spent; a team may send at most"):  # fmt: skip
        assert words in page, words
    assert "<b>5</b>" not in page
    assert "/withdraw" not in page


def test_what_is_asked_first_waits_for_the_word_of_its_team(
    api: "Api", alpha: "TeamBrowser", browse: Open
) -> None:
    assert 'name="asks_first" value="true"' in alpha.get("/submit").text
    address = alpha.submit("a", asks_first="true").headers["location"]
    asked_id = address.rpartition("/")[2]
    asked = "It will be scored but not ranked: 66.96% < 99%."
    replaced = 'It replaces 8b7jazz0gvrkppag (HCC 33.56, rank 1) of "Kestrel".'
    api.reject(asked_id, REPORT.model_copy(update={"faults": (), "to_confirm": (replaced, asked)}))
    page = alpha.get(address).text
    for words in (
        "not confirmed",
        "No quota is spent",
        '<li class="now"',
        '<a href="/submissions/8b7jazz0gvrkppag">8b7jazz0gvrkppag</a> (HCC 33.56',
        asked.replace("<", "&lt;"),
        "Confirm it</button>",
        "Leave it",
    ):
        assert words in page, words
    assert re.search(r"Confirm it until \d\d? [A-Z][a-z]{2} 20\d\d, \d\d:\d\d UTC, or", page)
    assert "<title>Planner, not confirmed: ExceptionDrive</title>" in page
    organizers = browse(api, who="organizer").get("/organize/submissions").text
    assert re.findall(r'class="badge st [^>]*>([^<]+)<', organizers) == ["not confirmed"]
    renamed = api.submit("a", method="Other", asks_first="true")
    assert "that submission waits for your word, no quota was spent" in renamed.json()["detail"]
    listed = alpha.get("/my").text
    assert "Nothing is counted yet. It replaces <a href=" in listed
    assert "The file has" not in page + listed
    beta = browse(api, who="beta")
    assert beta.post(f"{address}/confirm", {}, page="/submit").status_code == 404
    assert api.post(f"{address}/confirm", "beta").status_code == 404

    answers = [alpha.post(f"{address}/confirm", {}, page="/submit") for _ in range(2)]
    (counted,) = {answer.headers["location"] for answer in answers}
    assert [answer.status_code for answer in answers] == [303, 303]
    assert counted != address
    assert f"{counted.rpartition('/')[2]}</a> is in its place" in alpha.get(address).text
    assert api.post(f"{address}/confirm", "alpha").json()["id"] == counted.rpartition("/")[2]
    assert api.post(f"{counted}/confirm", "alpha").status_code == 409
    assert f'<a href="{counted}">another one</a> is in its' in alpha.get("/my").text


def test_what_would_replace_another_entry_by_now_is_asked_anew(
    api: "Api", alpha: "TeamBrowser"
) -> None:
    """As after a merge of teams, or a run that was scored meanwhile."""
    standing = api.submit("a").json()["id"]
    api.score(standing)
    address = alpha.submit("b", asks_first="true").headers["location"]
    asked_id = address.rpartition("/")[2]
    asked = 'It replaces 8b7jazz0gvrkppag (HCC 26.68, rank 2) of "Planner".'
    api.reject(asked_id, REPORT.model_copy(update={"faults": (), "to_confirm": (asked,)}))
    with api.database.write() as session:
        submission = session.get_one(Submission, asked_id)
        until, submission.confirm_until = submission.confirm_until, database_now(session)
    assert api.post(f"{address}/confirm", "alpha").status_code == 409, "the time has passed"
    with api.database.write() as session:
        session.get_one(Submission, asked_id).confirm_until = until
    led = alpha.post(f"{address}/confirm", {}, page="/submit").headers["location"]
    assert "by now it would replace another entry than you were asked about" in alpha.get(led).text
    with api.database.write() as session:
        report = REPORT.model_copy(update={"faults": (), "to_confirm": (asked,)})
        session.get_one(Submission, asked_id).report = report
    told = api.post(f"{address}/confirm", "alpha").json()
    assert (told["id"], told["status"]) == (asked_id, "rejected")
    (question,) = told["report"]["to_confirm"]
    assert question.startswith(f"It replaces {standing} (HCC ")
    assert f'<a href="/submissions/{standing}">' in alpha.get(address).text
    assert api.post(f"{address}/confirm", "alpha").json()["id"] != asked_id


def test_what_is_asked_tells_a_token_that_may_only_submit_no_score(
    api: "Api", alpha: "TeamBrowser"
) -> None:
    asked_id = alpha.submit("a", asks_first="true").headers["location"].rpartition("/")[2]
    asked = 'It replaces 8b7jazz0gvrkppag (HCC 33.56, rank 1) of "Kestrel".'
    api.reject(asked_id, REPORT.model_copy(update={"faults": (), "to_confirm": (asked,)}))
    given = {"name": "ci", "scopes": ["submit"]}
    api.tokens["ci"] = api.post("/tokens", "alpha", json=given).json()["token"]
    told = {who: api.submit("a", who, asks_first="true").json() for who in ("alpha", "ci")}
    assert [each["id"] for each in told.values()] == [asked_id] * 2
    assert told["alpha"]["report"]["to_confirm"] == [asked]
    (question,) = told["ci"]["report"]["to_confirm"]
    assert question.endswith("a token with the scope read:own is told it.")


def test_what_was_not_confirmed_in_time_says_that_its_file_is_deleted(
    api: "Api", alpha: "TeamBrowser"
) -> None:
    api.score(api.submit("b").json()["id"])  # it would be replaced by now, which nobody is asked
    address = alpha.submit("a", asks_first="true").headers["location"]
    asked_id = address.rpartition("/")[2]
    asked = "It will be scored but not ranked: 66.96% < 99%."
    api.reject(asked_id, REPORT.model_copy(update={"faults": (), "to_confirm": (asked,)}))
    with api.database.write() as session:
        submission = session.get_one(Submission, asked_id)
        submission.confirm_until = database_now(session) - timedelta(minutes=1)
    page, listed = alpha.get(address).text, alpha.get("/my").text
    assert "It was not confirmed in time" in page
    assert "It was not confirmed in time" in listed
    assert "Confirm it</button>" not in page + listed
    seen = api.get(address, "alpha").json()
    assert (seen["status"], seen["confirm_until"]) == ("rejected", None)
    refused = api.post(f"{address}/confirm", "alpha")
    assert (refused.status_code, "Send the file again" in refused.json()["detail"]) == (409, True)


def test_what_was_asked_before_a_disqualification_is_not_offered_for_confirmation(
    api: "Api", alpha: "TeamBrowser"
) -> None:
    address = alpha.submit("a", asks_first="true").headers["location"]
    report = REPORT.model_copy(update={"faults": (), "to_confirm": ("It replaces another.",)})
    api.reject(address.rpartition("/")[2], report)
    why = {"reason": "The file was copied."}
    assert api.post("/organizer/teams/alpha/disqualify", "organizer", json=why).status_code == 201
    page = alpha.get(address).text
    assert "It was not confirmed: it counts for nothing." in page
    assert "It has been disqualified since" in page
    for words in ("Confirm it", "Submit a file</a>", "in time", "The file has"):
        assert words not in page + alpha.get("/my").text.split("Table of submissions")[1]
    assert api.post(f"{address}/confirm", "alpha").json()["code"] == "not_allowed"


def test_what_an_archived_phase_asked_first_is_not_offered_for_confirmation(
    api: "Api", alpha: "TeamBrowser"
) -> None:
    address = alpha.submit("a", asks_first="true").headers["location"]
    report = REPORT.model_copy(update={"faults": (), "to_confirm": ("It replaces another.",)})
    api.reject(address.rpartition("/")[2], report)
    assert api.request("PATCH", "/organizer/phases/dev", "organizer",
                       json={"visibility": "archived"}).status_code == 200  # fmt: skip
    page = alpha.get(address).text
    for words in ("Confirm it", "Submit a file</a>"):
        assert words not in page + alpha.get("/my").text.split("Table of submissions")[1]
    assert "Send it again while the phase takes files." in page
    assert api.post(f"{address}/confirm", "alpha").json()["code"] == "phase_closed"


def test_a_scored_submission_shows_its_sheet_then_its_rank(
    api: "Api", alpha: "TeamBrowser", make_entry: Callable[..., Any]
) -> None:
    submission_id = api.submit("a").json()["id"]
    api.score(submission_id)
    page = alpha.get(f"/submissions/{submission_id}").text
    assert "50.00" in page
    assert "The next board is being built" in page
    api.publish(make_entry("Planner", submission_id=submission_id))
    page = alpha.get(f"/submissions/{submission_id}").text
    assert f"/entries/{submission_id}" in page
    assert "being built" not in page


def test_the_intervals_of_a_submission_have_the_decimals_that_they_have_on_its_board(
    api: "Api", alpha: "TeamBrowser", make_entry: Callable[..., Any]
) -> None:
    submission_id = api.submit("a").json()["id"]
    api.score(submission_id)
    entry = make_entry("Planner", submission_id=submission_id)
    api.publish(entry)
    assert "40 to 60" in alpha.get(f"/submissions/{submission_id}").text
    beside = make_entry("Other", rank=2, source="reference", team="Reference")
    api.publish(entry, beside.model_copy(update={"intervals": {"hcc": (0.4286, 0.6)}}))
    assert "40.00 to 60.00" in alpha.get(f"/submissions/{submission_id}").text


def test_withdrawing_on_the_page_takes_it_off(api: "Api", alpha: "TeamBrowser") -> None:
    address = alpha.submit("a").headers["location"]
    answer = alpha.post(f"{address}/withdraw", {}, page=address)
    assert (answer.status_code, answer.headers["location"]) == (303, address)
    assert "It stands on no board" in alpha.get(address).text
    assert "/withdraw" not in alpha.get(address).text
    assert '<li class="withdrawn">withdrawn</li>' in alpha.get(address).text
    assert "this file can be sent again" in alpha.get(address).text
    assert '<a class="btn" href="/submit?phase=dev#upload">' in alpha.get(address).text
    assert alpha.submit("a").headers["location"] != address
    assert "\u00b1 reaches" not in alpha.get("/my").text


def test_events_of_an_ended_submission_say_so_and_end(api: "Api", alpha: "TeamBrowser") -> None:
    submission_id = api.submit("a").json()["id"]
    api.score(submission_id)
    api.publish()
    answer = alpha.get(f"/submissions/{submission_id}/events", "text/event-stream")
    assert answer.headers["content-type"].startswith("text/event-stream")
    assert answer.text.count("event: submission") == 1


def test_the_pages_run_nothing_that_stands_in_them(api: "Api", alpha: "TeamBrowser") -> None:
    submission_id = api.submit("a", method="<script>alert(1)</script>").json()["id"]
    for path in ("/my", f"/submissions/{submission_id}", "/submit", "/my/tokens", "/sign-in"):
        answer = alpha.get(path)
        assert "<script>alert" not in answer.text
        assert " onclick" not in answer.text
        assert "style=" not in answer.text
        assert "script-src 'self'" in answer.headers["content-security-policy"]


def test_a_refused_form_keeps_what_was_typed_and_says_why(alpha: "TeamBrowser") -> None:
    typed = {
        "method": 'A "quoted" <b>planner</b>',
        "description": "Drives\r\nwell.",
        "paper_url": "http://plain.example/p",
    }
    fields = {**alpha.form("/submit"), "phase": "dev", **typed}
    files = {"file": ("planner.json", b"{}")}
    answer = alpha.send("/submit", fields, accept="text/html", files=files)
    assert answer.status_code == 400
    text = answer.text
    assert 'class="refused" role="alert"' in text
    assert 'value="A &#34;quoted&#34; &lt;b&gt;planner&lt;/b&gt;"' in text
    assert ">Drives\nwell.</textarea>" in text
    assert 'value="http://plain.example/p"' in text
    assert answer.headers["cache-control"] == "no-store"
    as_problem = alpha.send("/submit", fields, accept="application/problem+json", files=files)
    assert as_problem.json()["detail"].replace("'", "&#39;") in text


def test_an_empty_file_and_a_missing_field_are_refused_in_place(alpha: "TeamBrowser") -> None:
    fields = {**alpha.form("/submit"), "phase": "dev", "method": "Kept"}
    empty = {"file": ("planner.json", b"")}
    answer = alpha.send("/submit", fields, accept="text/html", files=empty)
    assert (answer.status_code, 'value="Kept"' in answer.text) == (400, True)
    assert "The file holds nothing" in answer.text
    nameless = {**fields, "method": "", "description": "Still here."}
    answer = alpha.send("/submit", nameless, accept="text/html", files=empty)
    assert answer.status_code == 400
    assert "<li><b>method</b>:" in answer.text
    assert ">Still here.</textarea>" in answer.text


def test_what_a_file_looks_like_is_worked_out_for_who_asks(
    api: "Api", alpha: "TeamBrowser"
) -> None:
    def n_asked() -> int:
        with api.database.read() as session:
            return session.query(Profile).count()

    place = alpha.submit("a").headers["location"]
    name = place.removeprefix("/submissions/")
    alpha.get(place)
    assert n_asked() == 0, "a score comes first"
    api.score(name)
    assert not api.get(f"/submissions/{name}", "alpha").json()["awaits_profile"]
    assert n_asked() == 0, "a program that waits for its score asks for no more"
    assert api.get(f"/submissions/{name}?profile=true", "alpha").json()["awaits_profile"]
    alpha.get(place)
    assert n_asked() == 1
    with api.database.write() as session:
        session.execute(update(Profile).values(state=WorkState.FAILED))
    assert "This is being computed" not in alpha.get(place).text
    assert not api.get(f"/submissions/{name}?profile=true", "alpha").json()["awaits_profile"]
    with api.database.read() as session:
        assert session.scalars(select(Profile.state)).all() == [WorkState.FAILED]
