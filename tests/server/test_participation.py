"""What organizers do with teams: by API and by page, refused to teams, in the audit log."""

import hashlib
import json
import re
from collections.abc import Callable
from datetime import UTC, datetime, timedelta, timezone
from functools import partial
from typing import TYPE_CHECKING, Any

import pytest
from sqlalchemy import select, text, update
from sqlalchemy.exc import IntegrityError

from exceptiondrive_records.audit.log import audit, verify_audit
from exceptiondrive_records.boards.tables import BoardFlip, BoardRow
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.notifications.channels import text_of
from exceptiondrive_records.notifications.tables import ContactPoint, Notification
from exceptiondrive_records.operations.dump import dump_rows, dumped_tables
from exceptiondrive_records.operations.invariants import broken_boards, violations
from exceptiondrive_records.participation import changes as changes_of_teams
from exceptiondrive_records.participation.tables import Disqualification
from exceptiondrive_records.phases.changes import update_phase
from exceptiondrive_records.phases.phases import deciding_settings
from exceptiondrive_records.phases.policy import pseudonym_of_team
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.teams.teams import find_team
from exceptiondrive_schemas.api.notifications import NotificationView
from exceptiondrive_schemas.api.phase_settings import PhaseChange
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.board import BoardNews

if TYPE_CHECKING:
    from tests.support.application import Api, TeamBrowser

Open = Callable[..., "TeamBrowser"]
WHY = {"reason": "two accounts of one lab"}
ACTIONS: list[tuple[str, str, Any]] = [
    ("GET", "teams/alpha/participation", None),
    ("PATCH", "teams/alpha", {**WHY, "name": "Gamma"}),
    ("POST", "teams/alpha/merge", {**WHY, "into": "beta"}),
    ("POST", "teams/alpha/forget", WHY),
    ("POST", "teams/alpha/disqualify", WHY),
    ("POST", "submissions/x/disqualify", WHY),
    ("GET", "disqualifications", None),
    ("POST", "disqualifications/1/reinstate", WHY),
    ("PATCH", "teams/alpha/allowances/dev", {**WHY, "quota_total": 2}),
    ("POST", "team-imports", {"csv": "id,name\nx,X\n"}),
    ("POST", "messages", {"title": "A", "text": "B"}),
]


@pytest.fixture
def organizer(api_on_both: "Api", browse: Open) -> "TeamBrowser":
    return browse(api_on_both, who="organizer")


@pytest.mark.parametrize(("method", "path", "body"), ACTIONS)
def test_a_team_may_do_none_of_it(
    api: "Api", as_problem: Callable[..., Any], method: str, path: str, body: Any
) -> None:
    more = {} if body is None else {"json": body}
    as_problem(api.request(method, f"/organizer/{path}", "alpha", **more), 403, "not_allowed")
    as_problem(api.request(method, f"/organizer/{path}", **more), 401, "not_signed_in")


def test_an_entry_is_disqualified_and_reinstated_by_api(
    api_on_both: "Api", as_problem: Callable[..., Any], browse: Callable[..., "TeamBrowser"]
) -> None:
    api = api_on_both
    own = api.submit("a").json()["id"]
    api.score(own)
    note = {**WHY, "public_note": "Not by a planner."}
    path = f"/organizer/submissions/{own}/disqualify"
    made = api.post(path, "organizer", json=note)
    assert (made.status_code, made.json()["submission"]) == (201, own)
    assert api.last_line().action == "submission disqualified"
    assert api.last_line().detail["reason"] == WHY["reason"]
    as_problem(api.post(path, "organizer", json=note), 409, "conflict")
    as_problem(api.submit("a"), 403, "not_allowed")
    alpha = browse(api, who="alpha")
    assert "<b>Disqualified</b>" in alpha.get("/my").text
    assert api.get(f"/submissions/{own}", "alpha").json()["disqualified_at"] is not None
    told = api.get("/notifications", "alpha").json()[0]
    assert (told["kind"], told["what_changed"][0]) == ("disqualified", f"Reason: {WHY['reason']}")
    notes = api.get("/phases/dev/disqualifications").json()
    assert [one["note"] for one in notes] == ["Not by a planner."]
    number = made.json()["id"]
    path = f"/organizer/disqualifications/{number}/reinstate"
    assert api.post(path, "organizer", json=WHY).status_code == 200
    as_problem(api.post(path, "organizer", json=WHY), 409, "conflict")
    assert api.get("/phases/dev/disqualifications").json() == []


def test_a_team_is_disqualified_and_reinstated_by_page(
    api_on_both: "Api", organizer: "TeamBrowser", make_entry: Callable[..., Any]
) -> None:
    api = api_on_both
    own = api.submit("a").json()["id"]
    api.score(own)
    here = "/organize/teams/alpha"
    page = f"{here}/disqualify"
    assert "cannot" not in organizer.get(here).text
    note = {**WHY, "public_note": "Cheated <b>"}
    assert "Phase: must not be empty." in organizer.post(page, note, page=page).text
    done = organizer.post(page, {**note, "phase_id": "*"}, page=page)
    assert done.headers["location"] == f"{here}?done=disqualified"
    assert "Cheated &lt;b&gt;" in organizer.get(here).text
    api.publish(make_entry("Other", submission_id=None, source="reference", rank=None))
    assert "Cheated &lt;b&gt;" in organizer.fresh().get("/").text
    page = "/organize/disqualifications/1/reinstate"
    asked = organizer.get(page).text
    assert WHY["reason"] in asked
    assert "every phase" in asked
    done = organizer.post(page, {"reason": "They explained it."}, page=page)
    assert done.headers["location"] == f"{here}?done=reinstated"
    assert "Cheated" not in organizer.fresh().get("/").text
    seen = f"/organize/submissions/{own}/disqualify"
    assert organizer.post(seen, WHY, page=seen).headers["location"].endswith("done=disqualified")
    assert "Disqualified: see the team" in organizer.get(f"/organize/submissions/{own}").text
    asked = organizer.get("/organize/disqualifications/2/reinstate").text
    assert "Reinstate the entry Planner of Alpha" in asked


def test_a_message_is_previewed_and_shows_no_address(
    api_on_both: "Api", organizer: "TeamBrowser"
) -> None:
    api = api_on_both
    hook = {"channel": "webhook", "address": "https://example.com/secret-hook"}
    assert api.post("/contacts", "beta", json=hook).status_code == 201
    page = "/organize/messages"
    words = {"title": "The <deadline>", "text": "It moves.\n\nBy a day."}
    preview = organizer.post(page, words, page=page)
    assert preview.status_code == 200
    for part in (
        "Send to 2 teams",
        "Alpha",
        "Beta",
        "by webhook: 1",
        "By a day.",
        "&lt;deadline&gt;",
    ):
        assert part in preview.text
    assert "secret-hook" not in preview.text
    assert api.get("/notifications", "alpha").json() == []
    sent = organizer.post(page, {**words, "is_seen": "yes"}, page=page)
    assert sent.headers["location"] == "/organize/teams?done=message_sent"
    told = api.get("/notifications", "alpha").json()[0]
    assert (told["kind"], told["title"], told["what_changed"]) == (
        "message",
        "The <deadline>",
        ["It moves.", "By a day."],
    )
    mail = text_of(NotificationView.model_validate_json(json.dumps(told)), "https://b.example")
    assert "\n\nThe <deadline>\n\nIt moves.\n\nBy a day.\n\nhttps://b.example/" in mail
    again = organizer.post(page, {**words, "is_seen": "yes"}, page=page)
    assert again.status_code == 409
    one = {**words, "title": "Other", "teams": ["beta"], "is_preview": True}
    found = api.post("/organizer/messages", "organizer", json=one).json()
    assert (found["is_sent"], found["recipients"]) == (
        False,
        [{"team": "beta", "name": "Beta", "n_emails": 0, "n_webhooks": 1}],
    )
    api.post("/organizer/messages", "organizer", json={**one, "is_preview": False})
    assert len(api.get("/notifications", "alpha").json()) == 1
    assert len(api.get("/notifications", "beta").json()) == 2
    assert "title" in api.last_line().detail


def test_a_team_that_became_part_of_another_is_written_to_and_changed_no_more(
    api_on_both: "Api", organizer: "TeamBrowser"
) -> None:
    """It has no people, no tokens and no inbox that anybody reads."""
    api = api_on_both
    why = {**WHY, "into": "beta"}
    here = "/organize/teams/alpha"
    actions = (f"{here}/merge", f"{here}/disqualify", f"{here}/tokens", "messages?team=alpha")
    before = organizer.get(here).text
    assert [action for action in actions if action not in before] == []
    assert api.post("/organizer/teams/alpha/merge", "organizer", json=why).status_code == 200
    page = organizer.get(here).text
    assert [action for action in actions if action in page] == []
    assert 'merged into <a href="/organize/teams/beta">Beta</a>' in page
    assert (
        'merged into <a href="/organize/teams/beta">Beta</a>'
        in organizer.get("/organize/teams").text
    )
    assert "alpha" not in organizer.get("/organize/messages").text
    words = {"title": "The deadline", "text": "It moves.", "is_preview": True}
    to_all = api.post("/organizer/messages", "organizer", json=words).json()
    assert [one["team"] for one in to_all["recipients"]] == ["beta"]
    refused = api.post("/organizer/messages", "organizer", json={**words, "teams": ["alpha"]})
    assert (refused.status_code, "part of beta" in refused.text) == (409, True)
    gone = api.post("/organizer/teams/beta/forget", "organizer", json=WHY).json()["id"]
    to_all = api.post("/organizer/messages", "organizer", json=words).json()
    assert to_all["recipients"] == []
    refused = api.post("/organizer/messages", "organizer", json={**words, "teams": [gone]})
    assert (refused.status_code, "is forgotten" in refused.text) == (409, True)


def test_names_allowances_and_addresses_stand_on_the_page_of_a_team(
    api_on_both: "Api", organizer: "TeamBrowser"
) -> None:
    api = api_on_both
    api.post("/contacts", "alpha", json={"channel": "email", "address": "ada@example.com"})
    here = "/organize/teams/alpha"
    assert "ada@example.com" in organizer.get(here).text
    page = f"{here}/change"
    words = {"name": "Gamma", "affiliation": "University of X", **WHY}
    assert organizer.post(page, words, page=page).headers["location"].startswith(here)
    assert api.last_line().detail["name"] == ["Alpha", "Gamma"]
    assert "University of X" in organizer.get(here).text
    taken = organizer.post(page, {**words, "name": "Beta"}, page=page)
    assert taken.status_code == 409
    page = f"{here}/allowances/dev"
    done = organizer.post(page, {"quota_per_day": "7", **WHY}, page=page)
    assert done.headers["location"] == f"{here}?done=allowance_set"
    assert api.get("/phases/dev", "alpha").json()["quota"]["per_day"] == 7
    assert api.get("/phases/dev", "beta").json()["quota"]["per_day"] == 5
    assert 'value="7"' in organizer.get(page).text
    later = {"closes_at": "2100-01-01T00:00", **WHY}
    endless = organizer.post(page, later, page=page)
    assert (endless.status_code, "has no deadline" in endless.text) == (400, True)
    change = partial(api.request, "PATCH", "/organizer/teams/alpha/allowances/dev", "organizer")
    assert change(json={"quota_total": 9, **WHY}).json()["quota_per_day"] == 7, "left out, it stays"
    gone = change(json={"quota_per_day": None, "quota_total": None, **WHY})
    assert gone.json()["granted_at"] is None
    assert api.get("/phases/dev", "alpha").json()["quota"]["per_day"] == 5


def test_a_deadline_of_a_team_that_the_phase_has_passed_by_is_told_nowhere_and_stops_nothing(
    api_on_both: "Api", organizer: "TeamBrowser"
) -> None:
    api, allowance = api_on_both, "/organizer/teams/alpha/allowances/dev"
    move = partial(api.request, "PATCH", "/organizer/phases/dev", "organizer")
    assert move(json={"closes_at": "2101-01-01T00:00:00Z"}).status_code == 200
    own = {"closes_at": "2102-01-01T00:00:00Z", **WHY}
    assert (
        api.request("PATCH", allowance, "organizer", json=own).json()["closes_at"]
        == own["closes_at"]
    )
    assert api.get("/phases/dev", "alpha").json()["quota"]["closes_at"] == own["closes_at"]
    page = "/organize/teams/alpha/allowances/dev"
    assert "2102-01-01" in organizer.get(page).text
    assert move(json={"closes_at": "2103-01-01T00:00:00Z"}).status_code == 200
    assert api.get("/phases/dev", "alpha").json()["quota"]["closes_at"] is None
    seen = api.get("/organizer/teams/alpha/participation", "organizer").json()
    assert [one["closes_at"] for one in seen["allowances"]] == [None]
    assert "2102-01-01" not in organizer.get(page).text
    assert (
        "2102-01-01"
        not in organizer.get("/organize/teams/alpha")
        .text.split("Own deadline")[1]
        .split("</section>")[0]
    )
    more = {"quota_total": 50, **WHY}
    assert api.request("PATCH", allowance, "organizer", json=more).status_code == 200
    assert "2102-01-01" not in str(api.get("/notifications", "alpha").json()[0])
    given = api.request("PATCH", allowance, "organizer", json={**own, "quota_per_day": 9})
    assert (given.status_code, given.json()["closes_at"], given.json()["quota_per_day"]) == (
        200,
        None,
        9,
    )
    inbox = api.get("/notifications", "alpha").json()
    assert "2102-01-01" not in str(inbox[0])
    assert api.request("PATCH", allowance, "organizer", json=own).status_code == 400, "another one"


def test_the_history_of_a_team_is_in_words(api_on_both: "Api", organizer: "TeamBrowser") -> None:
    api = api_on_both
    api.request("PATCH", "/organizer/phases/dev", "organizer", json={"title": "The <season>"})
    own = {"quota_per_day": 33, **WHY}
    api.request("PATCH", "/organizer/teams/alpha/allowances/dev", "organizer", json=own)
    renamed = {"name": "Alef", **WHY}
    api.request("PATCH", "/organizer/teams/alpha", "organizer", json=renamed)
    allowance = "phase: The &lt;season&gt; (dev); was: nothing; is: submissions a day are 33"
    words = (allowance, "name: Alpha → Alef", "is reference: no")
    for page in ("/organize/teams/alpha", "/organize/audit?subject=alpha"):
        seen = organizer.get(page).text
        assert [each for each in words if each not in seen] == []
    api.post("/organizer/teams/alpha/disqualify", "organizer", json={"phase": "dev", **WHY})
    where = '<td data-k="phase">The &lt;season&gt;</td>'
    assert where in organizer.get("/organize/teams/alpha").text


def test_a_name_that_another_takes_at_the_same_moment_is_a_conflict_and_no_outage(
    api_on_both: "Api", monkeypatch: pytest.MonkeyPatch, as_problem: Callable[..., Any]
) -> None:
    """Both looked before either wrote: then the unique index of the table says no."""
    monkeypatch.setattr(changes_of_teams, "require_free_name", lambda *_: None)
    change = {**WHY, "name": "Beta"}
    answer = api_on_both.request("PATCH", "/organizer/teams/alpha", "organizer", json=change)
    assert "at this moment" in as_problem(answer, 409, "conflict")["detail"]


def test_two_teams_are_merged_by_page(api_on_both: "Api", organizer: "TeamBrowser") -> None:
    api = api_on_both
    own = api.submit("a").json()["id"]
    page = "/organize/teams/alpha/merge"
    asked = {"into": "beta", **WHY}
    words = "the other team does not get it. Only one run of a method counts"
    assert words in " ".join(organizer.get(page).text.split())
    for again in ("", "beta"):
        refused = organizer.post(page, {**asked, "again": again}, page=page)
        assert (refused.status_code, "Type alpha" in refused.text) == (400, True)
    assert api.get("/me", "alpha").status_code == 200
    done = organizer.post(page, {**asked, "again": "alpha"}, page=page)
    assert done.headers["location"] == "/organize/teams/beta?done=teams_merged"
    assert api.get(f"/submissions/{own}", "beta").json()["team"] == "Beta"
    assert api.get("/me", "alpha").status_code == 401


def test_many_teams_are_imported_by_page_with_tokens_that_work(
    api_on_both: "Api", organizer: "TeamBrowser"
) -> None:
    api = api_on_both
    page = "/organize/teams/import"
    wrong = organizer.post(page, {"csv": "id,name\nalpha,New\nnew,New\n"}, page=page)
    assert (wrong.status_code, "Line 2" in wrong.text) == (400, True)
    made = organizer.post(page, {"csv": "id,name,email\nnew,New,a@example.com\n"}, page=page)
    token = re.search(r"new,(edk_\w+)", made.text)
    assert token is not None
    assert made.headers["cache-control"] == "no-store"
    api.tokens["new"] = token[1]
    assert api.get("/me", "new").json()["team"] == "New"
    with api.database.read() as session:
        assert session.scalars(select(ContactPoint.address)).all() == ["a@example.com"]
    table = {"csv": "id,name\nnewer,Newer\n"}
    by_api = api.post("/organizer/team-imports", "organizer", json=table)
    assert [one["id"] for one in by_api.json()["teams"]] == ["newer"]


def test_terms_are_accepted_on_a_page_or_by_api_before_an_upload(
    api_on_both: "Api", browse: Open, as_problem: Callable[..., Any]
) -> None:
    api = api_on_both
    change = {"page": {"terms": "Be *fair*."}, "policy": {"terms_required": True}}
    with api.database.write() as session:
        update_phase(session, "dev", PhaseChange.model_validate(change), actor="test")
    assert "/my/terms/dev" in as_problem(api.submit("a"), 403, "not_allowed")["detail"]
    made = api.post("/tokens", "beta", json={"name": "ci", "scopes": ["submit"]})
    ci = browse(api)
    ci.sign_in_with(made.json()["token"])
    assert "Accept for Beta" in ci.get("/my/terms/dev").text
    browser = browse(api)
    assert 'href="/my/terms/dev"' in browser.get("/phases/dev").text
    browser.sign_in("alpha")
    page, first = "/my/terms/dev", "accept the terms of this phase"
    assert first in browser.get("/submit").text
    assert "<em>fair</em>" in browser.get(page).text
    version = re.search(r'name="version" value="(\w+)"', browser.get(page).text)
    assert version is not None
    assert browser.post(page, {"version": "other"}, page=page).status_code == 409
    assert browser.post(page, {"version": version[1]}, page=page).status_code == 303
    assert "Accepted" in browser.get(page).text
    assert first not in browser.get("/submit").text
    assert api.submit("a").status_code == 202
    seen = api.get("/phases/dev", "beta").json()
    assert (seen["terms_version"], seen["terms_accepted_at"]) == (version[1], None)
    post = api.post("/phases/dev/terms", "beta", json={"version": version[1]})
    assert post.json()["version"] == version[1]
    found = api.get("/organizer/teams/beta/participation", "organizer").json()
    assert [one["version"] for one in found["terms"]] == [version[1]]
    with api.database.write() as session:
        session.get_one(Phase, "dev").visibility = "hidden"
    assert api.get("/phases/dev/disqualifications").status_code == 404


def test_a_forgotten_team_stands_under_an_alias_and_the_board_keeps_its_digest(
    api_on_both: "Api", organizer: "TeamBrowser", make_entry: Callable[..., Any]
) -> None:
    api = api_on_both
    api.post("/contacts", "alpha", json={"channel": "email", "address": "ada@example.com"})
    own = api.submit("a", description="By Ada of Alpha").json()["id"]
    api.score(own)
    api.publish(make_entry("Baseline", source="reference", rank=None))
    row = api.publish(make_entry("Planner", submission_id=own, team="Alpha"))
    assert "Alpha" in api.client.get("/history?phase=dev").text
    page = "/organize/teams/alpha/forget"
    wrong = organizer.post(page, {"again": "beta", "reason": "They asked."}, page=page)
    assert wrong.status_code == 400
    done = organizer.post(page, {"again": "alpha", "reason": "They asked."}, page=page)
    alias = re.search(
        r"/organize/teams/(former-\w+)\?done=team_forgotten", done.headers["location"]
    )
    assert alias is not None
    told = api.get("/boards/dev/2", headers={"Accept-Encoding": "identity"})
    assert told.json()["entries"][0]["team"] == f"Former team {alias[1][7:].upper()}"
    assert told.headers["etag"] == f'"{hashlib.sha256(told.content).hexdigest()}"'
    for address in ("/", "/history?phase=dev", "/api/v1/leaderboard?phase=dev", f"/entries/{own}"):
        seen = api.client.get(address, headers={"Accept": "text/html, application/json"})
        assert (seen.status_code, "Alpha" in seen.text) == (200, False), address
    assert api.get("/me", "alpha").status_code == 401
    assert "Alpha" not in organizer.get(f"/organize/teams/{alias[1]}").text
    with api.database.read() as session:
        kept = session.get_one(BoardRow, row.id)
        assert (kept.digest, kept.body_digest) == (row.digest, row.body_digest)
        assert verify_audit(session).is_whole
        assert list(broken_boards(session)) == []
        assert {one.address for one in session.scalars(select(ContactPoint))} == {""}
        told_words = [one.body for one in session.scalars(select(Notification))]
        mine = session.scalars(select(Submission).where(Submission.id == own)).one()
        assert (mine.description, "Alpha" in "".join(told_words)) == ("", False)
    again = api.post(f"/organizer/teams/{alias[1]}/forget", "organizer", json=WHY)
    assert again.status_code == 409


def test_what_is_told_of_a_board_differs_in_forgotten_teams_alone(
    api_on_both: "Api", make_entry: Callable[..., Any]
) -> None:
    """Whoever may write what the server writes tells no score, rank or name of their own."""
    api = api_on_both
    own, other = (
        api.submit(each, team).json()["id"] for each, team in (("a", "alpha"), ("b", "beta"))
    )
    for each in (own, other):
        api.score(each)
    row = api.publish(
        make_entry("Planner", submission_id=own, team="Alpha"),
        make_entry("Other", submission_id=other, team="Beta", rank=2),
    )
    assert api.post("/organizer/teams/alpha/forget", "organizer", json=WHY).status_code == 200
    recorded, told = json.loads(row.body), api.get("/boards/dev/1").json()
    recorded["entries"][0]["team"] = told["entries"][0]["team"]
    assert told["entries"][0]["team"].startswith("Former team ")
    assert told == recorded
    for name in ("Winner", "Former team with more"):
        forged = {"name": name, "forgotten_at": row.published_at}
        change = update(Team).where(Team.slug == "beta").values(**forged)
        with api.database.write() as session, pytest.raises(IntegrityError, match="ck_former"):
            session.execute(change)


def test_verify_finds_a_team_that_nobody_forgot_and_one_that_came_back(api: "Api") -> None:
    assert api.post("/organizer/teams/alpha/forget", "organizer", json=WHY).status_code == 200
    with api.database.read() as session:
        assert violations(session) == []
    with api.database.write() as session:
        session.execute(update(Team).where(Team.slug != "beta").values(forgotten_at=None))
        beta = find_team(session, "beta")
        beta.name, beta.forgotten_at = "Former team 234567", database_now(session)
    with api.database.read() as session:
        assert {each.rule for each in violations(session)} == {
            "forgotten by nobody",
            "forgotten and back",
        }


def test_verify_finds_entries_that_nobody_withdrew_or_moved(api: "Api") -> None:
    """As whoever holds the server's role may write them."""
    kept, own, moved = (api.submit(name).json()["id"] for name in "abc")
    for each in (kept, own, moved):
        api.score(each)
    api.post(f"/submissions/{kept}/withdraw", "alpha")
    note = {**WHY, "public_note": "Not by a planner."}
    api.post(f"/organizer/submissions/{moved}/disqualify", "organizer", json=note)
    with api.database.read() as session:
        assert violations(session) == []
    with api.database.write() as session:
        row = session.get_one(Submission, own)
        row.status, row.withdrawn_at = SubmissionStatus.WITHDRAWN, database_now(session)
        session.get_one(Submission, moved).team_id = api.team_ids["beta"]
    with api.database.read() as session:
        assert {(each.rule, each.subject) for each in violations(session)} == {
            ("withdrawn by nobody", own),
            ("submission of another team", moved),
        }
    with api.database.write() as session:
        find_team(session, "alpha").merged_into_id = api.team_ids["beta"]
        session.execute(update(Disqualification).values(public_note="cheated"))
    with api.database.read() as session:
        rules = {each.rule for each in violations(session)}
        assert rules >= {"merged by nobody", "disqualified by nobody"}


def test_verify_names_each_row_that_cannot_be_read_and_looks_at_all_the_others(
    api_on_both: "Api",
) -> None:
    """As whoever holds the server's role may write them; nothing hides behind a broken document."""
    api = api_on_both
    broken, own = (api.submit(name).json()["id"] for name in "ab")
    with api.database.write() as session:
        session.execute(text("UPDATE submissions SET report='{}' WHERE id=:id"), {"id": broken})
        session.execute(text("UPDATE phases SET page='[]' WHERE id='dev'"))
        session.get_one(Submission, own).team_id = api.team_ids["beta"]
    with api.database.read() as session:
        found = {(each.rule, each.subject) for each in violations(session)}
    assert found == {
        ("row unreadable", f"submissions/{broken}"),
        ("row unreadable", "phases/dev"),
        ("submission of another team", own),
    }
    with api.database.write() as session:
        session.execute(text("UPDATE submissions SET facts='7' WHERE id=:id"), {"id": broken})
    with api.database.read() as session:
        rules = {each.rule for each in violations(session)}
    assert rules == {"row unreadable", "rule broken off"}


def test_verify_finds_a_board_that_nobody_showed(
    api: "Api", make_entry: Callable[..., Any]
) -> None:
    """As whoever holds the server's role may turn a public board back."""
    one = api.submit("a").json()["id"]
    for rank in (1, 2):
        api.publish(make_entry("Planner", submission_id=one, rank=rank))
    with api.database.write() as session:
        first = session.scalars(select(BoardRow.id).order_by(BoardRow.number)).first()
        assert not [each for each in violations(session) if each.rule == "shown by nobody"]
        session.get_one(Phase, "dev").current_board_id = first
    with api.database.read() as session:
        assert "shown by nobody" in {each.rule for each in violations(session)}


def test_verify_finds_what_decides_a_board_and_nobody_did(
    api_on_both: "Api", make_entry: Callable[..., Any]
) -> None:
    """As whoever holds the server's role may write it: name, choice, deadline, reinstatement, news."""
    api = api_on_both
    own, other = (api.submit(name).json()["id"] for name in "ab")
    for each in (own, other):
        api.score(each)
    late = (datetime.now(UTC) + timedelta(hours=9)).astimezone(timezone(timedelta(hours=2)))
    change = {"closes_at": late.isoformat(), "policy": {"run_choice": "team"}}
    assert api.request("PATCH", "/organizer/phases/dev", "organizer", json=change).is_success
    assert api.post(f"/submissions/{own}/choose", "alpha", json={"rule": "best"}).is_success
    edit = {"method": "Renamed"}
    assert api.request("PATCH", f"/submissions/{own}", "alpha", json=edit).is_success
    out = api.post("/organizer/teams/beta/disqualify", "organizer", json={**WHY, "phase": "dev"})
    assert out.is_success
    for rank in (1, 2):
        api.publish(make_entry("Planner", submission_id=own, rank=rank))
    with api.database.write() as session:  # an action of its own that moves a date, and says so
        phase = session.get_one(Phase, "dev")
        before, phase.closes_at = (
            deciding_settings(phase)["closes_at"],
            datetime.now(UTC) + timedelta(hours=9),
        )
        detail = {
            "reason": "an outage",
            "closes_at": [before, deciding_settings(phase)["closes_at"]],
        }
        audit(session, "organizer", "phase prolonged", "dev", detail)
    with api.database.read() as session:
        assert not {each.rule for each in violations(session)} & UNLOGGED
    with api.database.write() as session:
        chosen, unsaid = (session.get_one(Submission, each) for each in (own, other))
        chosen.method, chosen.chosen_rule = "I cheat", "newest"
        unsaid.chosen_at = database_now(session)
        phase = session.get_one(Phase, "dev")
        phase.closes_at = database_now(session) - timedelta(hours=1)
        phase.policy = phase.policy.model_copy(update={"entries_shown": "chosen"})
        session.execute(update(Disqualification).values(reinstated_at=database_now(session)))
        newest = session.scalars(select(BoardFlip).order_by(BoardFlip.id.desc())).first()
        assert newest is not None
        again = {"phase_id": "dev", "board_id": newest.board_id}
        session.add(BoardFlip(**again, at=newest.at, news=BoardNews(n_more=3)))
    with api.database.read() as session:
        found = [(each.rule, each.subject) for each in violations(session)]
    assert sorted(each for each in found if each[0] in UNLOGGED) == [
        ("chosen by nobody", min(own, other)),
        ("chosen by nobody", max(own, other)),
        ("history altered", "dev/2"),
        ("phase changed by nobody", "dev"),
        ("phase changed by nobody", "dev"),
        ("reinstated by nobody", "1"),
        ("renamed by nobody", own),
    ]


UNLOGGED = {
    "chosen by nobody",
    "history altered",
    "phase changed by nobody",
    "reinstated by nobody",
    "renamed by nobody",
}


def test_a_team_that_was_merged_is_forgotten_with_the_one_it_became_part_of(
    api_on_both: "Api", make_entry: Callable[..., Any]
) -> None:
    """Its name stood on boards, in their news and history, in its own notices and questions."""
    api = api_on_both
    api.post("/phases/dev/questions", "alpha", json={"text": "May Alpha use maps?"})
    own = api.submit("a", description="By Ada of Alpha").json()["id"]
    api.score(own)
    api.publish(make_entry("Baseline", source="reference", rank=None))
    row = api.publish(make_entry("Planner", submission_id=own, team="Alpha"))
    merged = api.post("/organizer/teams/alpha/merge", "organizer", json={**WHY, "into": "beta"})
    assert merged.status_code == 200
    refused = api.post("/organizer/teams/alpha/forget", "organizer", json=WHY)
    assert (refused.status_code, "forget that one" in refused.text) == (409, True)
    again = api.post("/organizer/teams/alpha/merge", "organizer", json={**WHY, "into": "beta"})
    assert again.status_code == 409
    done = api.post("/organizer/teams/beta/forget", "organizer", json=WHY)
    assert done.status_code == 200
    for address in ("/", "/history?phase=dev", "/api/v1/leaderboard?phase=dev", f"/entries/{own}"):
        seen = api.client.get(address, headers={"Accept": "text/html, application/json"})
        assert (seen.status_code, "Alpha" in seen.text) == (200, False), address
    for address in ("/organizer/teams", "/organizer/questions"):
        told = api.get(address, "organizer")
        assert told.status_code == 200
        assert not re.search("alpha|beta", told.text, re.IGNORECASE), address
    with api.database.read() as session:
        kept = {table.name: "\n".join(dump_rows(session, table)) for table in dumped_tables()}
    named = {name for name, text in kept.items() if re.search("alpha", text, re.IGNORECASE)}
    assert named == {"audit_lines", "boards", "board_flips"}, "append-only, as the docs say"
    with api.database.read() as session:
        assert session.get_one(BoardRow, row.id).digest == row.digest
        assert verify_audit(session).is_whole
        assert list(broken_boards(session)) == []


def test_a_forgotten_team_keeps_its_pseudonyms_on_anonymous_boards(
    api_on_both: "Api", make_entry: Callable[..., Any]
) -> None:
    """The alias beside a pseudonym would say which entries were of one team, and whose."""
    api = api_on_both
    with api.database.write() as session:
        change = PhaseChange.model_validate({"policy": {"anonymous": True}})
        update_phase(session, "dev", change, actor="test")
    with api.database.read() as session:
        phase = session.get_one(Phase, "dev")
        pseudonym = pseudonym_of_team(phase, find_team(session, "alpha").id)
    own = api.submit("a").json()["id"]
    api.score(own)
    entry = make_entry("Planner", submission_id=own, team=pseudonym)
    api.publish(make_entry("Baseline", source="reference", rank=None))
    api.publish(entry)
    api.post("/organizer/teams/alpha/merge", "organizer", json={**WHY, "into": "beta"})
    assert api.post("/organizer/teams/beta/forget", "organizer", json=WHY).status_code == 200
    told = api.get("/boards/dev/2").json()
    assert [one["team"] for one in told["entries"]] == [pseudonym]
    history = api.client.get("/history?phase=dev", headers={"Accept": "text/html"}).text
    assert (pseudonym in history, "Former team" in history) == (True, False)
    api.publish(make_entry("Another", submission_id=own, team=pseudonym))
    history = api.client.get("/history?phase=dev", headers={"Accept": "text/html"}).text
    assert "No HCC changed." in history
