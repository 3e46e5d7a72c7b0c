"""The pages under /organize: who may see them, that forms cannot be forged, what each step does."""

import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest
from fastapi.routing import APIRoute
from sqlalchemy import select, text

from exceptiondrive_records.audit.log import PROBING_SUSPECTED, SPLIT_FLOOR_HELD, audit_once
from exceptiondrive_records.audit.tables import AuditLine
from exceptiondrive_records.news.questions import ask_question
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.splits.tables import SplitRow
from exceptiondrive_records.teams.teams import register_team
from exceptiondrive_records.work.heartbeats import beat
from exceptiondrive_schemas.datasheet import NO_RECORDED_DRIVE, SplitWarning, SplitWarnings
from exceptiondrive_server.audit import organizer_pages as audit_routes
from exceptiondrive_server.operations import organizer_pages as overview_routes
from exceptiondrive_server.phases import organizer_pages as phase_routes
from exceptiondrive_server.protocols import organizer_pages as protocol_routes
from exceptiondrive_server.rescoring import organizer_pages as run_routes
from exceptiondrive_server.submissions import organizer_pages as submission_routes
from exceptiondrive_server.teams import organizer_pages as team_routes

if TYPE_CHECKING:
    from tests.support.application import Api, TeamBrowser

Open = Callable[..., "TeamBrowser"]


@pytest.fixture
def organizer(api: "Api", browse: Open) -> "TeamBrowser":
    """A browser in which an organizer signed in."""
    return browse(api, who="organizer")


PARTS = (
    overview_routes,
    team_routes,
    phase_routes,
    submission_routes,
    protocol_routes,
    run_routes,
    audit_routes,
)


def routes(method: str) -> list[str]:
    """Every address of the organizers' pages that takes this method, with a made-up id."""
    found = [
        route.path
        for part in PARTS
        for route in part.router.routes
        if isinstance(route, APIRoute) and method in (route.methods or ())
    ]
    return [re.sub(r"{[a-z_]+}", "x1", path) for path in found]


def test_only_organizers_see_the_pages(api: "Api", browse: Open) -> None:
    stranger, alpha = browse(api), browse(api)
    alpha.sign_in("alpha")
    addresses = routes("GET")
    assert len(addresses) > 4
    for path in addresses:
        led = stranger.get(path)
        assert (led.status_code, led.headers["location"][:8]) == (303, "/sign-in"), path
        assert alpha.get(path).status_code == 403, path


def test_only_organizers_change_anything(api: "Api", browse: Open) -> None:
    stranger, alpha = browse(api), browse(api)
    alpha.sign_in("alpha")
    with api.database.read() as session:
        before = session.query(AuditLine).count()
    addresses = routes("POST")
    assert addresses
    for path in addresses:
        assert stranger.send(path, {}).status_code == 303, path
        forged = alpha.send(path, {**alpha.form("/my"), "reason": "because"})
        assert forged.status_code == 403, path
    with api.database.read() as session:
        assert session.query(AuditLine).count() == before


def test_a_form_from_elsewhere_or_without_its_token_changes_nothing(
    api: "Api", organizer: "TeamBrowser"
) -> None:
    with api.database.read() as session:
        before = session.query(AuditLine).count()
    for path in routes("POST"):
        bare = organizer.send(path, {"reason": "because"})
        assert bare.status_code == 403, path
        far = organizer.client.post(
            path,
            data={**organizer.form("/my"), "reason": "because"},
            headers={"Origin": "https://evil.test"},
        )
        assert far.status_code == 403, path
    with api.database.read() as session:
        assert session.query(AuditLine).count() == before


def test_an_organizer_is_led_to_the_pages_and_finds_back_from_the_board(
    api: "Api", browse: Open
) -> None:
    browser = browse(api)
    assert browser.sign_in("organizer").headers["location"] == "/organize"
    assert 'href="/organize"' in browser.get("/").text
    browser.post("/sign-out", {}, page="/my")
    assert 'href="/organize"' not in browser.get("/").text
    browser.sign_in("alpha")
    assert 'href="/organize"' not in browser.get("/").text


def test_the_overview_names_what_waits(api: "Api", organizer: "TeamBrowser") -> None:
    quiet = organizer.get("/organize").text
    assert "No worker is alive" in quiet
    submission_id = api.submit("a").json()["id"]
    api.fail(submission_id)
    with api.database.write() as session:
        register_team(session, "newcomers", "New Comers", "We are <b>new</b>.")
        beat(session, "worker-7")
    page = organizer.get("/organize").text
    assert "No worker is alive" not in page
    assert "worker-7" in page
    for words, link, named in (
        ("1 submission failed", "/organize/submissions?status=failed", "store_broken"),
        ("1 team waits", "/organize/teams?show=pending", "New Comers"),
    ):
        assert words in page
        assert f'href="{link}"' in page
        assert named in organizer.get(link).text
        assert "<b>new</b>" not in organizer.get(link).text


def test_the_overview_lists_the_worst_first_and_what_may_stand_for_a_season_last(
    api: "Api", organizer: "TeamBrowser"
) -> None:
    api.fail(api.submit("a").json()["id"])
    with api.database.write() as session:
        split = session.scalars(select(SplitRow)).one()
        lacking = SplitWarning(code=NO_RECORDED_DRIVE, what="no drive", count=split.n_samples)
        split.warnings = SplitWarnings(found=(lacking,))
        register_team(session, "newcomers", "New Comers", "We are new.")
        ask_question(session, api.team_ids["alpha"], "dev", "May we?", actor="test")
    page = organizer.get("/organize").text
    found = re.findall(r'<li class="card (bad|warn)">\s*<span class="written">(.*?)</span>', page)
    words = ("No worker", "1 submission failed", "1 team waits", "1 question", "Split sample")
    levels, told = zip(*found, strict=True)
    assert levels == ("bad", "bad", *["warn"] * (len(levels) - 2))
    places = [next(n for n, text in enumerate(told) if text.startswith(each)) for each in words]
    assert (places, places[-1]) == (sorted(places), len(told) - 1)


def test_the_overview_says_what_workers_refused_and_suspect(
    api: "Api", organizer: "TeamBrowser"
) -> None:
    asked = {"phase": "dev", "protocol": "1.0", "asked": ["waypoints is 1, it must lie from 4"]}
    with api.database.write() as session:
        asked["revision"] = session.get_one(Phase, "dev").split_revision
        for _ in range(2):
            audit_once(session, "worker", SPLIT_FLOOR_HELD, "sample", asked)
        of_a_cancelled_run = asked | {"protocol": "9.0", "asked": ["what nobody asks any more"]}
        audit_once(session, "worker", SPLIT_FLOOR_HELD, "sample", of_a_cancelled_run)
        audit_once(session, "worker", PROBING_SUSPECTED, "dev", {"teams": ["Alpha"]})
    page = organizer.get("/organize").text
    words = (
        "The floors of split sample refused what phase dev asks for: waypoints is 1, it must lie"
    )
    assert page.count(words) == 1
    assert "what nobody asks any more" not in page
    assert "Phase dev has submissions that change a few samples at a time" in page
    for address in ("/organize/audit?subject=sample", "/organize/similar/dev"):
        assert f'href="{address}"' in page
        assert organizer.get(address).status_code == 200
    api.score(api.submit("a").json()["id"])
    assert words not in organizer.get("/organize").text, "the floors let it through since"


def test_submissions_are_narrowed_and_paged(
    api: "Api", organizer: "TeamBrowser", monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("exceptiondrive_server.submissions.organizer_pages.SHOWN", 2)
    for number in range(3):
        api.submit(f"file {number}", "alpha", method=f"Alpha {number}")
    api.submit("file b", "beta", method="Beta 1")
    page = organizer.get("/organize/submissions?team=alpha").text
    first = re.findall(r"Alpha \d", page)
    assert len(first) == 2
    assert "Beta 1" not in page
    older = page.split('class="btn" href="/organize/submissions?')[1].split('"')[0]
    page = organizer.get("/organize/submissions?" + older.replace("&amp;", "&")).text
    assert len({*first, *re.findall(r"Alpha \d", page)}) == 3
    assert "Beta 1" not in page
    assert "No submission matches" in organizer.get("/organize/submissions?status=scored").text
    for typo in ("team=nobody", "phase=nowhere"):
        assert organizer.get(f"/organize/submissions?{typo}").status_code == 404
        assert organizer.get(f"/organize/submissions/archive?{typo}").status_code == 404


def test_a_failed_submission_is_tried_again_with_a_reason(
    api: "Api", organizer: "TeamBrowser"
) -> None:
    submission_id = api.submit("a").json()["id"]
    here = f"/organize/submissions/{submission_id}"
    early = organizer.post(f"{here}/retry", {"reason": "x"}, page=f"{here}/retry")
    assert early.status_code == 409
    api.fail(submission_id)
    shown = organizer.get(here).text
    assert "store_broken" in shown
    assert f"{here}/retry" in shown
    bare = organizer.post(f"{here}/retry", {"reason": " "}, page=f"{here}/retry")
    assert (bare.status_code, "must not be empty" in bare.text) == (400, True)
    done = organizer.post(f"{here}/retry", {"reason": "the store is back"}, page=f"{here}/retry")
    assert (done.status_code, done.headers["location"]) == (303, f"{here}?done=submission_retried")
    assert api.get(f"/submissions/{submission_id}", "alpha").json()["status"] == "received"
    with api.database.read() as session:
        query = select(AuditLine).where(AuditLine.action == "scoring retried by hand")
        line = session.scalars(query).one()
    assert line.detail == {"reason": "the store is back"}
    assert line.actor.startswith("token:")
    page = organizer.get(done.headers["location"]).text
    assert "queued again" in page
    assert "the store is back" in page


def test_the_list_shows_scores_and_the_page_of_one_all_that_is_done_with_it(
    api: "Api", organizer: "TeamBrowser", make_entry: Callable[..., Any]
) -> None:
    one = api.submit("a").json()["id"]
    api.score(one)
    api.publish(make_entry("Planner", submission_id=one, rank=3))
    body = organizer.get("/organize/submissions").text.split("<tbody>")[1]
    row = " ".join(re.sub(r"<[^>]+>", " ", body).split())
    assert re.search(r"^Planner .* scored 3 .*50\.00 ±10\.0 25\.00", row), row
    here = f"/organize/submissions/{one}"
    page = organizer.get(here).text
    for words in ("Score sheet", "HCC %", "50.00", "40 to 60"):
        assert words in page
    story = organizer.get(f"{here}/story").text
    assert "story.css" in story
    assert "<style" not in story, "the site allows none"
    for action in ("verify", "note", "file", "folder", "story"):
        assert f'href="{here}/{action}"' in page
    note = {"words": "We look into it.\n\nBack on Monday."}
    sent = organizer.post(f"{here}/note", note, page=f"{here}/note")
    assert (sent.status_code, sent.headers["location"]) == (303, f"{here}?done=team_told")
    twice = organizer.post(f"{here}/note", note, page=f"{here}/note")
    assert (twice.status_code, "was sent already" in twice.text) == (409, True)
    asked = organizer.post(f"{here}/verify", {"reason": "a dispute"}, page=f"{here}/verify")
    assert asked.headers["location"] == f"{here}?done=submission_verified"
    page = organizer.get(here).text
    for shown in ("We look into it.", "not read yet", "Recomputed", "waiting", "a dispute"):
        assert shown in page
    assert organizer.get(f"{here}/file").content == b"a"
    early = organizer.post(f"{here}/restore", {"reason": "x"}, page=f"{here}/restore")
    assert early.status_code == 409
    assert api.post(f"/submissions/{one}/withdraw", "alpha").status_code == 200
    done = organizer.post(f"{here}/restore", {"reason": "they erred"}, page=f"{here}/restore")
    assert done.headers["location"] == f"{here}?done=submission_restored"
    assert api.get(f"/submissions/{one}", "alpha").json()["status"] == "scored"


def test_the_log_names_submissions(api: "Api", organizer: "TeamBrowser") -> None:
    one = api.submit("a").json()["id"]
    assert (
        f'<a href="/organize/submissions/{one}">Planner</a>'
        in organizer.get("/organize/audit").text
    )


def test_the_log_is_narrowed_to_a_kind_from_a_day_on(
    api: "Api", organizer: "TeamBrowser", monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("exceptiondrive_server.audit.organizer_pages.SHOWN", 1)
    today = api.get("/organizer/audit?limit=1", "organizer").json()[0]["at"][:10]
    shown = organizer.get(f"/organize/audit?action=team+created&since={today}").text
    assert '<option value="team created" selected>' in shown
    assert f'name="since" value="{today}"' in shown
    days = organizer.get(f"/organize/audit?since={today}").text
    assert f"since={today}&amp;before=" in days
    kinds = organizer.get("/organize/audit?action=phase+created").text
    assert ("team created<small" in shown, "team created<small" in kinds) == (True, False)
    for nothing in ("since=2999-01-01", "since=9999-12-31", "action=none"):
        assert "No line matches" in organizer.get(f"/organize/audit?{nothing}").text
    assert "Line" in organizer.get("/organize/audit?since=&action=").text
    wrong = organizer.get("/organize/audit?since=lately")
    assert (wrong.status_code, "must be a day such as 2026-11-21" in wrong.text) == (400, True)
    assert "since." not in wrong.text.split("missing or wrong: since.")[1], "the field alone"


def test_the_log_is_filtered_paged_and_verified(
    api: "Api", organizer: "TeamBrowser", monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("exceptiondrive_server.audit.organizer_pages.SHOWN", 2)
    page = organizer.get("/organize/audit?subject=dev").text
    assert "phase created" in page
    assert "team created<small" not in page
    assert "Older lines" in organizer.get("/organize/audit").text
    assert "The chain is intact" in organizer.get("/organize/audit?verify=true").text
    with api.database.write() as session:
        session.execute(text("DROP TRIGGER audit_lines_no_update"))  # as one who owns the file
        session.query(AuditLine).filter_by(subject="dev").update({"actor": "nobody"})
    broken = organizer.get("/organize/audit?verify=true").text
    assert "The chain is broken at line" in broken


def test_an_unknown_key_of_what_was_done_says_nothing(organizer: "TeamBrowser") -> None:
    assert "notice good" not in organizer.get("/organize?done=<script>").text


def test_answers_are_kept_by_nobody(organizer: "TeamBrowser") -> None:
    for path in ("/organize", "/organize/submissions", "/organize/audit"):
        answer: Any = organizer.get(path)
        assert answer.headers["cache-control"] == "no-store"
        assert "script-src 'self'" in answer.headers["content-security-policy"]


def test_actions_of_a_phase_are_grouped_and_what_would_be_refused_is_not_offered(
    api: "Api", organizer: "TeamBrowser"
) -> None:
    page = organizer.get("/organize/phases/dev").text
    assert re.findall(r"<dt>(See|Do|For good)</dt>", page) == ["See", "Do", "For good"]
    assert "/organize/phases/dev/delete" in page
    assert page.index("/organize/phases/dev/freeze") < page.index("/organize/phases/dev/delete")
    phases = organizer.get("/organize/phases").text
    assert "at once" in phases
    assert "no deadline" in phases
    api.submit("one")
    assert "/organize/phases/dev/delete" not in organizer.get("/organize/phases/dev").text


def test_a_site_without_a_team_is_told_its_first_steps(
    api: "Api", organizer: "TeamBrowser"
) -> None:
    first = "nobody can submit"
    assert first not in organizer.get("/organize").text
    with api.database.write() as session:
        session.execute(text("UPDATE teams SET is_reference = true"))
    page = organizer.get("/organize").text
    assert first in page
    assert "is public but has no description, no rules, no deadline." in page
    assert "Nothing. No team is waiting" not in page


def test_nothing_is_told_as_compared_where_one_team_takes_part(
    api: "Api", organizer: "TeamBrowser"
) -> None:
    def said() -> str:
        return " ".join(organizer.get("/organize/similar/dev").text.split())

    assert "Nothing to compare yet: no team has a scored submission here." in said()
    api.score(api.submit("some bytes", "alpha").json()["id"])
    assert "Nothing to compare yet: one team has a scored submission here." in said()
    api.score(api.submit("other bytes", "beta").json()["id"])
    assert "None of 2 teams sent a submission equal or nearly equal" in said()


def test_a_report_that_is_not_there_yet_says_when_it_comes(organizer: "TeamBrowser") -> None:
    page = organizer.get("/phases/dev/report")
    assert page.status_code == 404
    words = "There is no report of the phase &#39;dev&#39; yet: it comes when all teams are done"
    assert words in page.text


def test_a_team_is_made_on_its_page_with_affiliation_and_address(organizer: "TeamBrowser") -> None:
    made = {"id": "lab", "name": "Lab", "affiliation": "Somewhere", "email": "lab@example.org"}
    organizer.post("/organize/teams", made, page="/organize/teams")
    assert "Somewhere" in organizer.get("/organize/teams").text
    assert "lab@example.org" in organizer.get("/organize/teams/lab").text


def test_alike_submissions_of_a_phase_are_reported(api: "Api", organizer: "TeamBrowser") -> None:
    for team in ("alpha", "beta"):
        api.score(api.submit("the same bytes", team, method=f"of {team}").json()["id"])
    assert 'href="/organize/similar/dev"' in organizer.get("/organize/phases/dev").text
    page = organizer.get("/organize/similar/dev").text
    for words in ("equal files", "of alpha", "of beta", "not proof",
                  "Paths for the original scene are not compared",
                  "0 scored submissions were compared", "2 more after the next board"):  # fmt: skip
        assert words in " ".join(page.split()), words
    assert organizer.get("/organize/similar/no-such").status_code == 404
    with api.database.write() as session:
        session.execute(text("UPDATE submissions SET confirmed_as = id WHERE method = 'of beta'"))
    assert "of beta" not in organizer.get("/organize/similar/dev").text


def test_the_api_refuses_teams_and_retries_submissions_by_the_same_rules(
    api: "Api", as_problem: Callable[[Any, int, str], dict[str, Any]]
) -> None:
    submission_id = api.submit("a").json()["id"]
    with api.database.write() as session:
        register_team(session, "delta", "Delta", "We are new.")
    reason = {"reason": "because"}
    retry, refuse = f"/organizer/submissions/{submission_id}/retry", "/organizer/teams/delta/refuse"
    for path in (retry, refuse):
        as_problem(api.post(path, "alpha", json=reason), 403, "not_allowed")
        as_problem(api.post(path, "organizer", json={}), 400, "bad_request")
    as_problem(api.post(retry, "organizer", json=reason), 409, "conflict")
    api.fail(submission_id)
    assert api.post(retry, "organizer", json=reason).json()["status"] == "received"
    assert api.post(refuse, "organizer", json=reason).json()["id"] == "delta"
    as_problem(api.post(refuse, "organizer", json=reason), 404, "not_found")
    alpha = "/organizer/teams/alpha/refuse"
    as_problem(api.post(alpha, "organizer", json=reason), 409, "conflict")
