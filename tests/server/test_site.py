"""The links that organizers set, on every page; and the public status."""

import html
import re
from datetime import date, timedelta
from typing import TYPE_CHECKING, Any

import pytest

from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.work.heartbeats import beat
from exceptiondrive_records.work.jobs import claim_job, finish_failed
from exceptiondrive_records.work.tables import Job, WorkerHeartbeat
from exceptiondrive_schemas.jobs import Lane

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.support.application import Api, TeamBrowser

    from exceptiondrive_schemas.board import BoardEntry

LINKS = {
    "paper_url": "https://paper.example.org/x",
    "code_url": "https://code.example.org/x",
    "citation": "@misc{ed,\n  title = {E}\n}",
    "contact": "ada@example.org",
}
PAGES = ("/", "/submit", "/api", "/status", "/phases/dev")


def links_of(page: str) -> dict[str, str]:
    """Title and address of the site's links in the footer."""
    found = re.findall(r'<a href="([^"]*)"[^>]*>([^<]*)</a>', page.split("<footer")[1])
    return {title: url for url, title in found if title in ("Paper", "Code", "Cite", "Contact")}


@pytest.fixture
def browser(api: "Api", browse: "Callable[..., TeamBrowser]") -> "TeamBrowser":
    return browse(api)


def test_nothing_is_linked_that_nobody_set(browser: "TeamBrowser") -> None:
    for page in PAGES:
        assert links_of(browser.get(page).text) == {}, page
    assert browser.get("/cite").status_code == 404


def test_links_that_an_organizer_sets_stand_on_every_page(
    api: "Api", browser: "TeamBrowser"
) -> None:
    changed = api.request("PATCH", "/organizer/site", "organizer", json=LINKS)
    assert changed.json() == LINKS == api.get("/site").json()
    for page in PAGES:
        text = browser.get(page).text
        assert links_of(text) == {
            "Paper": LINKS["paper_url"],
            "Code": LINKS["code_url"],
            "Cite": "/cite",
            "Contact": "mailto:ada@example.org",
        }
        assert text.count(LINKS["paper_url"]) >= 3  # header, menu of small screens, footer
    assert "@misc{ed," in browser.get("/cite").text
    line = api.get("/organizer/audit?limit=1", "organizer").json()[0]
    assert line["action"] == "site links changed"
    assert line["detail"]["code_url"] == ["", LINKS["code_url"]]
    taken = api.request("PATCH", "/organizer/site", "organizer", json={"code_url": ""})
    assert taken.json() == {**LINKS, "code_url": ""}
    assert "Code" not in links_of(browser.get("/").text)


def test_a_board_is_cited_beside_what_organizers_say_of_the_benchmark(
    api: "Api", browser: "TeamBrowser", make_entry: "Callable[..., BoardEntry]"
) -> None:
    api.publish(make_entry("Planner"))
    built_in, of_board = "@misc{exceptiondrive,", "@misc{exceptiondrive-dev-board-1,"
    bib = browser.get("/export/board.bib?phase=dev").text
    assert (bib.startswith(built_in), bib.count(of_board)) == (True, 1)
    api.request("PATCH", "/organizer/site", "organizer", json=LINKS)
    bib = browser.get("/export/board.bib?phase=dev").text
    assert bib.startswith(f"{LINKS['citation']}\n\n{of_board}")
    assert built_in not in bib


def test_an_organizer_sets_them_on_a_page(api: "Api", browser: "TeamBrowser") -> None:
    browser.sign_in("organizer")
    done = browser.post("/organize/site", LINKS, page="/organize/site")
    assert done.status_code == 303
    assert api.get("/site").json() == LINKS
    refused = browser.post(
        "/organize/site", {**LINKS, "paper_url": "http://x.org"}, page="/organize/site"
    )
    assert refused.status_code == 400
    assert "https://" in refused.text
    assert api.get("/site").json() == LINKS


@pytest.mark.parametrize(
    "change",
    [
        {"paper_url": "javascript:alert(1)"},
        {"code_url": "http://x.org/"},
        {"contact": "javascript:alert(1)"},
        {"contact": "mailto:a@b.org?bcc=all"},
        {"contact": "a@b.org?subject=x"},
        {"contact": "nobody"},
        {"citation": "a\u202eb"},
        {"citation": "x" * 4001},
        {"home": "https://x.org"},
    ],
)
def test_what_is_no_link_is_refused(api: "Api", change: dict[str, str]) -> None:
    assert api.request("PATCH", "/organizer/site", "organizer", json=change).status_code in (
        400,
        422,
    )
    assert set(api.get("/site").json().values()) == {""}


@pytest.mark.parametrize("who", [None, "alpha"])
def test_organizers_alone_set_links(api: "Api", who: str | None) -> None:
    refused = api.request("PATCH", "/organizer/site", who, json=LINKS)
    assert refused.status_code in (401, 403)


def let_pass(api: "Api", seconds: float) -> None:
    """Let every sign of life and every job be older."""
    past = timedelta(seconds=seconds)
    with api.database.write() as session:
        for sign in session.query(WorkerHeartbeat):
            sign.at -= past
            sign.lives_until -= past
        for job in session.query(Job):
            job.created_at -= past
    api.services.site_state.forget()


def test_the_status_tells_of_a_worker_that_fell_silent(api: "Api", browser: "TeamBrowser") -> None:
    with api.database.write() as session:
        beat(session, "worker-1")
    api.publish()
    told = api.get("/status").json()
    assert (told["state"], told["live_workers"], told["waiting"]) == ("up", 1, 0)
    assert told["last_board"]["phase"] == "dev"
    assert "delayed" not in browser.get("/").text
    let_pass(api, 60)
    told = api.get("/status").json()
    assert (told["state"], told["live_workers"]) == ("delayed", 0)
    for page in ("/", "/submit"):
        assert "Scoring is delayed: no worker is alive." in browser.get(page).text
    page = browser.get("/status")
    assert page.status_code == 200
    assert "Scoring is delayed" in page.text.split("<main")[1]


def test_the_status_page_calls_a_phase_by_its_title_and_dates_as_other_pages_do(
    api: "Api", browser: "TeamBrowser"
) -> None:
    named: Any = {"title": "The season"}
    assert api.request("PATCH", "/organizer/phases/dev", "organizer", json=named).status_code == 200
    api.score(api.submit("a").json()["id"])
    api.publish()
    text = " ".join(browser.get("/status").text.split())
    assert "The season, board " in text
    (day,) = re.findall(r'<time datetime="(\d{4}-\d\d-\d\d)">([^<]+)</time>', text)
    assert day[1] == f"{date.fromisoformat(day[0]):%-d %b %Y}"


def test_the_status_tells_how_long_the_oldest_waits(api: "Api", browser: "TeamBrowser") -> None:
    assert api.get("/status").json()["state"] == "up"  # nothing waits, and nobody is missed
    api.submit("a")
    api.services.site_state.forget()
    assert api.get("/status").json()["state"] == "delayed"
    let_pass(api, 1200)
    with api.database.write() as session:
        beat(session, "worker-1")
    told = api.get("/status").json()
    assert (told["state"], told["waiting"]) == ("delayed", 1)
    assert told["oldest_wait_s"] >= 1200
    assert "has waited for 20 minutes" in told["sentence"]
    assert "has waited for 20 minutes" in browser.get("/").text


def test_what_is_retried_has_waited_since_then(api: "Api", browser: "TeamBrowser") -> None:
    submission = api.submit("a").json()["id"]
    with api.database.write() as session:
        beat(session, "worker-1")
        job = claim_job(session, Lane.LIVE, 60, 4)
        assert job is not None
        finish_failed(session, job, "internal_error", "It failed.", retry=False)
    let_pass(api, 1200)
    retry = f"/organizer/submissions/{submission}/retry"
    assert api.request("POST", retry, "organizer", json={"reason": "mended"}).status_code == 200
    with api.database.write() as session:
        beat(session, "worker-1")
    told = api.get("/status").json()
    assert (told["state"], told["waiting"]) == ("up", 1)
    assert told["oldest_wait_s"] < 600
    assert "delayed" not in browser.get("/").text


def test_the_status_tells_how_the_days_went(api: "Api", browser: "TeamBrowser") -> None:
    for number in range(2):
        api.score(api.submit(f"{number}").json()["id"])
    with api.database.write() as session:
        for job, waited_s in zip(session.query(Job), (30, 900), strict=True):
            assert job.leased_at is not None
            job.created_at = job.leased_at - timedelta(seconds=waited_s)
        today = database_now(session).date()
    days = api.get("/status").json()["days"]
    assert {day["day"] for day in days} <= {str(today), str(today - timedelta(days=1))}
    assert max(day["longest_wait_s"] for day in days) == pytest.approx(900)
    assert sum(day["n_failed"] for day in days) == 0
    page = html.unescape(browser.get("/status").text)
    assert "15 minutes" in page
    assert "Failed by our own fault, or beyond a split's limit" in page


def test_what_came_weeks_ago_and_is_tried_again_today_is_no_day_of_this_week(api: "Api") -> None:
    api.score(api.submit("old").json()["id"])
    with api.database.write() as session:
        session.query(Job).one().created_at -= timedelta(days=20)
    assert api.get("/status").json()["days"] == []


def test_the_status_names_no_team_no_submission_and_no_hidden_phase(
    api: "Api", browser: "TeamBrowser"
) -> None:
    own = api.submit("a", method="Secret method").json()["id"]
    api.publish()
    hide: Any = {"visibility": "hidden"}
    assert api.request("PATCH", "/organizer/phases/dev", "organizer", json=hide).status_code == 200
    for text in (api.get("/status").text, browser.get("/status").text):
        for secret in (own, "Secret method", "alpha", "dev"):
            assert secret not in text.split("<main")[-1].split("</main>")[0], secret
    assert api.get("/status").json()["last_board"] is None


def test_all_who_tell_of_workers_believe_a_sign_of_life_for_as_long_as_it_says(
    api: "Api", browser: "TeamBrowser"
) -> None:
    with api.database.write() as session:
        beat(session, "worker-1", ttl_s=60)
    waits = api.submit("a").json()["id"]
    browser.sign_in("organizer")
    for seconds, n_alive in ((20, 1), (60, 0)):
        let_pass(api, seconds)
        assert api.get("/status").json()["live_workers"] == n_alive
        assert api.get("/readyz").json()["live_workers"] == n_alive
        assert f'live_workers{{lane="live"}} {n_alive}.0' in api.get("/metrics").text
        assert api.get(f"/submissions/{waits}", "alpha").json()["queue"]["workers_alive"] == n_alive
        page = browser.get("/organize").text
        assert ("No worker is alive" not in page, ">silent<" not in page) == (n_alive == 1,) * 2


def test_a_dead_worker_does_not_stay_in_the_metrics(api: "Api") -> None:
    with api.database.write() as session:
        beat(session, "dead-worker")
    assert 'heartbeat_age_seconds{worker="dead-worker"}' in api.get("/metrics").text
    assert 'exceptiondrive_live_workers{lane="live"} 1.0' in api.get("/metrics").text
    let_pass(api, 60)
    assert 'heartbeat_age_seconds{worker="dead-worker"}' in api.get("/metrics").text
    assert 'exceptiondrive_live_workers{lane="live"} 0.0' in api.get("/metrics").text
    let_pass(api, 3600)
    assert "dead-worker" not in api.get("/metrics").text
    with api.database.write() as session:
        beat(session, "new-worker")
    with api.database.read() as session:
        assert [sign.worker_id for sign in session.query(WorkerHeartbeat)] == ["new-worker"]
