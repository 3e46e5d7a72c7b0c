"""An organizer's walk in a real browser: document, run, progress, preview, apply, board, rollback."""

from collections.abc import Callable, Iterator
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, expect
from tests.support.browser import Look, axe_violations, look_at
from tests.support.serving import served

from exceptiondrive_records.accounts.tokens import ORGANIZER_SCOPES, issue_token
from exceptiondrive_records.phases.phases import find_phase
from exceptiondrive_records.teams.teams import register_team
from exceptiondrive_server.app import create_app
from exceptiondrive_server.web.settings import ServerSettings

Stage = Any
Make = Callable[..., str]
pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    pytest.mark.parametrize("database_url", ["sqlite"], indirect=True),
]
D_SAFE = ("d_safe_m = 2.0", "d_safe_m = 4.5")
LONGEST_MS = 60_000
RIGHT_TO_LEFT = """(text) => {
  text.firstElementChild.textContent = "\u05de\u05ea\u05db\u05e0\u05df";
  const last = text.getNumberOfChars() - 1;
  return [0, last].map((at) => text.getExtentOfChar(at).x);
}"""


@pytest.fixture
def site(stage: Stage) -> Iterator[str]:
    """Address of a running site over the stage."""
    app = create_app(
        ServerSettings(
            database_url=stage.settings.database_url,
            broker_url=stage.settings.broker_url,
            file_store_url=stage.settings.file_store_url,
        )
    )
    with served(app) as address:
        yield address


def signed_in(stage: Stage, browser: Browser, site: str, **context: Any) -> Page:
    with stage.database.write() as session:
        token, _ = issue_token(session, None, "Olga", ORGANIZER_SCOPES, actor="test")
    page = browser.new_context(**context).new_page()
    page.goto(f"{site}/sign-in")
    page.fill("input[name=token]", token)
    page.click("form.card button")
    page.wait_for_url("**/organize")
    return page


def say(page: Page, button: str) -> None:
    """Give a reason and press the button of a step."""
    page.fill("textarea[name=reason]", "announced on Monday")
    page.click(f"form.card button:text-is('{button}')")


def start_run(page: Page, site: str, toml: str) -> None:
    """From a document to a run that scores."""
    page.goto(f"{site}/organize/protocols/new")
    page.fill("textarea[name=toml]", toml)
    page.click("button:text-is('Check')")
    expect(page.locator(".verdict")).to_contain_text("2.0 -> 4.5 m")
    page.click("button:text-is('Add protocol 1.1')")
    page.click("tr:has-text('1.1') a:has-text('Rescore')")
    page.select_option("select[name=phase]", "dev")
    say(page, "Draft the run")
    page.click("a:text-is('Start scoring')")
    say(page, "Start scoring")


@pytest.mark.parametrize("width", [390, 1440])
def test_a_title_without_blanks_stays_within_the_page_of_news(
    stage: Stage, browser: Browser, site: str, width: int
) -> None:
    with stage.database.write() as session:
        find_phase(session, "dev").title = "T" * 120
    page = signed_in(stage, browser, site, viewport={"width": width, "height": 900})
    for path in ("/organize/news", "/organize/news?phase=dev"):
        page.goto(site + path)
        expect(page.locator("main")).to_contain_text("T" * 120)
        assert page.evaluate("document.documentElement.scrollWidth") <= width


@pytest.mark.parametrize("has_script", [True, False])
def test_a_walk_from_document_to_rollback(
    stage: Stage, browser: Browser, site: str, make_protocol: Make, has_script: bool
) -> None:
    page = signed_in(stage, browser, site, java_script_enabled=has_script)
    complaints: list[str] = []
    page.on("pageerror", lambda error: complaints.append(str(error)))
    start_run(page, site, make_protocol("1.1", *D_SAFE))
    expect(page.locator(".run-now")).to_contain_text("scoring in the background")
    run = page.url.split("?")[0]
    if has_script:
        page.focus("a:text-is('Pause')")
    stage.work(most=2)
    expect(page.locator("#live")).to_contain_text("2 of 3 sheets", timeout=LONGEST_MS)
    if has_script:
        expect(page.locator("a:text-is('Pause')")).to_be_focused()
    stage.work()
    expect(page.locator(".run-now")).to_contain_text("100 %", timeout=LONGEST_MS)
    page.goto(f"{run}/preview")
    expect(page.locator("svg.slope.wide")).to_be_visible()
    expect(page.locator("svg.slope.wide .sl text").first).to_contain_text(" · ")
    name, rank = page.locator("svg.slope.wide .sl text").first.evaluate(RIGHT_TO_LEFT)
    assert name < rank, "a name from right to left leaves its rank at the line"
    expect(page.locator("table.pv tbody tr").first).to_contain_text("slow")
    page.click("a:text-is('Apply')")
    say(page, "Apply")
    expect(page.locator(".notice.good")).to_contain_text("readers see the new board")
    page.goto(f"{site}/?phase=dev")
    expect(page.locator("main")).to_contain_text("1.1")
    page.goto(f"{run}/rollback")
    say(page, "Roll back")
    expect(page.locator(".notice.good")).to_contain_text("Rolled back")
    page.goto(f"{site}/organize/audit?verify=true")
    expect(page.locator(".notice.good")).to_contain_text("The chain is intact")
    assert complaints == []


EDGES = "(it) => [it.getBoundingClientRect().left, it.getBoundingClientRect().right]"


def test_axe_finds_nothing_wrong_and_no_page_scrolls_sideways(
    stage: Stage, browser: Browser, site: str, make_protocol: Make
) -> None:
    looks: tuple[Look, ...] = ((1360, "light"), (390, "dark"))
    run_id = stage.ready(make_protocol("1.1-withheld.final", *D_SAFE))
    with stage.database.write() as session:
        register_team(session, "newcomers", "New Comers", "We are new.")
    page = signed_in(stage, browser, site, bypass_csp=True)
    run = f"/organize/rescoring/{run_id}"
    for path in (
        "/organize",
        "/organize/teams",
        "/organize/teams/newcomers",
        "/organize/teams/newcomers/refuse",
        "/organize/phases",
        "/organize/phases/new",
        "/organize/phases/dev",
        "/organize/similar/dev",
        "/organize/submissions",
        f"/organize/submissions/{stage.submitted[0]}",
        "/organize/protocols",
        "/organize/protocols/new?start=1.0",
        "/organize/rescoring",
        "/organize/rescoring/new",
        run,
        f"{run}/preview",
        f"{run}/apply?preview=x",
        "/organize/verifications/new",
        "/organize/audit?verify=true",
    ):
        page.goto(site + path)
        for width, scheme in (*looks, (360, "dark")):
            look_at(page, (width, scheme))
            wider = page.evaluate("document.documentElement.scrollWidth - window.innerWidth")
            assert wider <= 0, f"{path} is {wider} px wider than {width} px"
            found = axe_violations(page) if (width, scheme) in looks else []
            assert [f"{one['id']}: {one['nodes'][0]['html'][:120]}" for one in found] == [], path
        if path == f"{run}/preview":
            titles = page.locator("svg.nar .t-ti").all()
            left, right = (title.evaluate(EDGES) for title in titles)
            assert left[1] <= right[0], "the titles run together"
