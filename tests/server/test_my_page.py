"""A team's own list: scores with their interval, change, trend, and why a run has no rank."""

import re
from collections.abc import Callable
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import pytest

from exceptiondrive_records.participation.allowances import set_allowance
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_schemas.api.submission import QueuePlace
from exceptiondrive_schemas.faults import CheckReport
from exceptiondrive_server.submissions import pages
from exceptiondrive_server.submissions.view import place_words

if TYPE_CHECKING:
    from tests.support.application import Api, TeamBrowser

MakeEntry = Callable[..., Any]


def my_rows(api: "Api", browse: Callable[..., "TeamBrowser"]) -> list[str]:
    browser = browse(api, who="alpha")
    page = browser.get("/my")
    assert page.status_code == 200
    body = page.text.split('class="mini subs runs"')[1].split("<tbody>")[1].split("</tbody>")[0]
    rows = re.sub(r"<svg[^>]*aria-label=\"([^\"]*)\".*?</svg>", r"[\1]", body, flags=re.DOTALL)
    plain = re.sub(r"<[^>]+>", " ", rows.replace("</tr>", "|"))
    return [" ".join(row.split()) for row in plain.split("|") if row.strip()]


def test_a_run_shows_score_interval_change_and_trend(
    api: "Api", browse: Callable[..., "TeamBrowser"], make_entry: MakeEntry
) -> None:
    first, second = (api.submit(text).json()["id"] for text in ("a", "b"))
    api.score(first, hcc=0.375)
    api.score(second, hcc=0.5)
    newest, oldest = my_rows(api, browse)
    assert "50.00 +12.50 ▲ better since the run before" in newest
    assert "[HCC of the runs so far: 37.50, 50.00]" in newest
    assert "Rank awaited: the next board is being built." in newest
    assert "Another run takes its place." in oldest
    api.publish(make_entry("Planner", submission_id=second))
    newest, oldest = my_rows(api, browse)
    assert "±10.0" in newest.split()
    assert 'data-k="HCC %"' in browse(api, who="alpha").get("/my").text
    assert "Stands in place of 1 other run." in newest
    assert "awaited" not in newest
    assert "±" not in oldest


def test_large_quotas_have_their_thousands_apart(
    api: "Api", browse: Callable[..., "TeamBrowser"]
) -> None:
    api.phase("many", quota_per_day=1234, quota_total=56789)
    with api.database.write() as session:
        set_allowance(session, "beta", "many", quota_per_day=2345, reason="asked", actor="test")
    team, organizer = browse(api), browse(api)
    team.sign_in("alpha")
    organizer.sign_in("organizer")
    for browser, page, words in (
        (team, "/phases/many", "1,234 a team and day, 56,789 in all"),
        (team, "/phases/many", "only so many files of all teams together are scored within a day"),
        (team, "/my", "1,234 of 1,234"),
        (team, "/my", "56,789 of 56,789"),
        (team, "/submit?phase=many", "1,234"),
        (organizer, "/organize/phases", ">1,234<"),
        (organizer, "/organize/teams/beta", ">2,345<"),
    ):
        text = " ".join(browser.get(page).text.split())
        assert words in text, (page, words)


def test_a_run_that_waits_stands_beside_one_with_a_score(
    api: "Api", browse: Callable[..., "TeamBrowser"]
) -> None:
    api.score(api.submit("a").json()["id"])
    api.submit("b")
    waiting, done = my_rows(api, browse)
    assert "next in line" in waiting
    assert "50.00" in done


def test_a_run_in_work_says_until_when_its_worker_has_it() -> None:
    queue = QueuePlace(
        position=0,
        expected_wait_s=0.0,
        attempts=1,
        workers_alive=1,
        lease_until=datetime(2026, 11, 26, 14, 4, 10, tzinfo=UTC),
    )
    assert place_words(queue) == "if its worker is lost, another begins again at 14:04:10 UTC"


def test_a_run_that_failed_by_our_fault_says_why(
    api: "Api", browse: Callable[..., "TeamBrowser"]
) -> None:
    api.fail(api.submit("a").json()["id"], "The split is not here.")
    (row,) = my_rows(api, browse)
    assert "The split is not here." in row


def test_what_is_not_ranked_says_why(
    api: "Api", browse: Callable[..., "TeamBrowser"], make_entry: MakeEntry
) -> None:
    one = api.submit("a").json()["id"]
    api.score(one)
    entry = make_entry("Planner", submission_id=one, rank=None)
    because = "66.96% of the samples are answered; a rank needs 99%"
    api.publish(entry.model_copy(update={"unranked_because": because}))
    (row,) = my_rows(api, browse)
    assert f"Not ranked: {because}." in row
    seen = api.get(f"/submissions/{one}", "alpha").json()
    assert (seen["unranked_because"], seen["awaits_board"]) == (because, False)
    browser = browse(api, who="alpha")
    assert because in browser.get(f"/submissions/{one}").text


def test_no_rank_is_awaited_that_the_file_will_not_get(
    api: "Api", browse: Callable[..., "TeamBrowser"]
) -> None:
    one = api.submit("a").json()["id"]
    api.score(one)
    browser, page = browse(api, who="alpha"), f"/submissions/{one}"
    assert "The next board is being built; the rank is awaited." in browser.get(page).text
    because = "66.96% of the samples are answered; a rank needs 99%"
    with api.database.write() as session:
        found = session.get_one(Submission, one)
        found.report = CheckReport(
            challenge=None,
            split=None,
            n_predictions=1,
            digest="d",
            size_bytes=1,
            unranked_because=because,
        )
    text = browser.get(page).text
    assert f"The next board is being built; it has no rank there: {because}." in text
    assert "awaited" not in text
    (row,) = my_rows(api, browse)
    assert f"Not ranked: {because}." in row


def test_older_submissions_are_offered_right_below_the_list(
    api: "Api", browse: Callable[..., "TeamBrowser"], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pages, "SHOWN", 1)
    older, _ = (api.submit(text).json()["id"] for text in ("a", "b"))
    browser = browse(api, who="alpha")
    page = browser.get("/my").text
    assert page.index("Older submissions") < page.index("What you may still submit")
    (path,) = re.findall(r'href="(/my\?after=[^"]+)"', page)
    following = browser.get(path).text
    assert f'href="/submissions/{older}"' in following
    assert "Older submissions" not in following


def test_families_stand_on_the_page_of_a_submission(
    api: "Api", browse: Callable[..., "TeamBrowser"]
) -> None:
    one = api.submit("a").json()["id"]
    api.score(one)
    browser = browse(api, who="alpha")
    families = list(api.get(f"/submissions/{one}", "alpha").json()["sheet"]["families"])
    assert ("Table of families" in browser.get(f"/submissions/{one}").text) == bool(families)


def test_a_team_finds_its_notices_receipt_and_facts_where_it_looks(
    api: "Api", browse: Callable[..., "TeamBrowser"], make_entry: MakeEntry
) -> None:
    one = api.submit("a").json()["id"]
    api.score(one)
    api.publish(make_entry("Planner", submission_id=one))
    note = {"words": "Your file is fine."}
    assert api.post(f"/organizer/submissions/{one}/note", "organizer", json=note).is_success
    browser = browse(api, who="alpha")
    mine = browser.get("/my").text
    assert "Notices (1 new)" in mine
    assert f'<a href="/submissions/{one}">The organizers wrote about Planner</a>' in mine
    page = browser.get(f"/submissions/{one}").text
    assert "Your file is fine." in page
    receipt = browser.get(f"/submissions/{one}/receipt")
    assert receipt.json() == api.get(f"/submissions/{one}/receipt", "alpha").json()
    assert "attachment" in receipt.headers["content-disposition"]
    facts = " ".join(re.sub(r"<[^>]+>", " ", browser.get("/my/team").text).split())
    assert "Submissions 1 Tokens 1 in use Told at no confirmed address yet" in facts
    stranger = browse(api, who="beta")
    for end in ("", "/receipt"):
        assert stranger.get(f"/submissions/{one}{end}").status_code == 404
