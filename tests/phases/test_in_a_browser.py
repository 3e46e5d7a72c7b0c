"""The states of a phase in a real browser: wide and light, narrow and dark, looked at by axe."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import pytest
from playwright.sync_api import Browser, Page, expect
from tests.phases.test_reported import ROWS, sent
from tests.support.browser import Look, axe_violations, look_at
from tests.support.serving import served

if TYPE_CHECKING:
    from tests.phases.life import Life

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
    pytest.mark.parametrize("database_url", ["sqlite"], indirect=True),
]
SPEEDS = {"alpha": 3.5, "beta": 2.0, "gamma": 5.0}
OF_TEAM = (
    "/?phase=frozen",
    "/?phase=late&view=late",
    "/?phase=late",
    "/?phase=masked",
    "/?phase=parted",
    "/?phase=own",
    "/phases/ended/report",
    "/my",
)
OF_ORGANIZER = ("/organize/phases", "/organize/phases/masked", "/organize/phases/new")


@pytest.fixture
def site(life: "Life") -> Iterator[str]:
    """Address of the site, with a phase in each state."""
    _fill(life)
    with served(life.client.app) as address:
        yield address


def _fill(life: "Life") -> None:
    """One phase for each state, with an entry of each team and two of Alpha's in its own phase."""
    late, own = {"late_entries": "own_view"}, {"entries_shown": "chosen", "entries_private": True}
    life.make_phase("frozen", title="Frozen challenge", split="plain")
    life.make_phase(
        "late", title="With late view", split="plain", closes_at=life.ahead(60), policy=late
    )
    life.make_phase("masked", title="Blind review", split="plain", policy={"anonymous": True})
    life.make_phase("parted", title="Public part")
    life.make_phase("own", title="Choose and publish", split="plain", policy=own)
    life.make_phase("ended", title="Last year", split="plain", closes_at=life.ahead(60))
    for phase in ("frozen", "late", "masked", "parted", "own", "ended"):
        split = "parted" if phase == "parted" else "plain"
        for who, speed in SPEEDS.items():
            life.submit(who, speed, f"{who.title()}Drive", split, phase)
    better = life.submit("alpha", 1.0, "AlphaDrive 2", "plain", "own")
    life.work()
    for what in ("choose", "publish"):
        address = f"/api/v1/submissions/{better}/{what}"
        assert life.request("POST", address, "alpha").status_code == 200
    life.move("late", closes_at=life.now())
    life.submit("gamma", 1.0, "GammaDrive late", "plain", "late")
    for phase in ("frozen", "ended"):
        life.done(f"/phases/{phase}/freeze")
    life.submit("gamma", 0.5, "GammaDrive 2", "plain", "ended")
    life.work()
    life.move("ended", closes_at=life.now())
    life.done("/phases/ended/reveal", {"what": "board", "reason": "the end"})


def signed_in(life: "Life", browser: Browser, site: str, who: str, **context: Any) -> Page:
    page = browser.new_context(bypass_csp=True, **context).new_page()
    page.goto(f"{site}/sign-in")
    page.fill("input[name=token]", life.tokens[who])
    page.click("form.card button")
    page.wait_for_url(lambda address: "/sign-in" not in address)
    return page


def complaints(page: Page) -> list[str]:
    """What axe finds, and whether the page is wider than the screen."""
    found = axe_violations(page)
    wider = page.evaluate("document.documentElement.scrollWidth - window.innerWidth")
    words = [f"{one['id']}: {one['nodes'][0]['html'][:160]}" for one in found]
    return words + ([f"{wider} px too wide"] if wider > 0 else [])


def test_every_state_of_a_phase_reads_well(life: "Life", browser: Browser, site: str) -> None:
    looks: tuple[Look, ...] = ((1440, "light"), (390, "dark"))
    for who, paths in (("alpha", OF_TEAM), ("organizer", OF_ORGANIZER)):
        page = signed_in(life, browser, site, who)
        for path in paths:
            page.goto(site + path)
            for look in looks:
                look_at(page, look)
                assert complaints(page) == [], (path, look)


def test_a_team_publishes_by_a_click_without_script(
    life: "Life", browser: Browser, site: str
) -> None:
    page = signed_in(life, browser, site, "beta", java_script_enabled=False)
    page.goto(f"{site}/my")
    row = page.locator("tr", has_text="Choose and publish").first
    row.locator("button", has_text="Publish it").click()
    expect(page).to_have_url(f"{site}/my")
    expect(page.locator("tr", has_text="Choose and publish").first).to_contain_text("Published")
    life.work()
    page.goto(f"{site}/?phase=own")
    expect(page.locator("tr.own")).to_contain_text("BetaDrive")
    expect(page.locator("tr.own")).to_contain_text("Yours")


def test_past_phases_can_be_reached_on_every_screen(life: "Life", browser: Browser) -> None:
    for name in ("now", "a", "b", "old"):
        life.make_phase(name, split="plain", title=f"A challenge called {name}")
    life.change({"visibility": "archived"}, "old")
    with served(life.client.app) as address:
        for width in (1440, 1280, 700, 390):
            page = browser.new_context(viewport={"width": width, "height": 844}).new_page()
            page.goto(address)
            page.click(".phases .past summary")
            assert page.evaluate("document.documentElement.scrollWidth") <= width
            box = page.locator(".phases .past > div").bounding_box()
            assert box is not None
            assert box["x"] >= 0
            page.click(".phases .past a", timeout=5000)
            expect(page.locator("h1")).to_be_visible()
            assert "phase=old" in page.url


def test_what_differs_on_an_external_board_is_read_on_a_narrow_screen(
    life: "Life", browser: Browser
) -> None:
    life.make_phase(split="plain")
    life.done("/phases/test/reported", sent(ROWS))
    with served(life.client.app) as address:
        page = browser.new_context(viewport={"width": 390, "height": 844}).new_page()
        page.goto(f"{address}/phases/test/reported")
        box = page.locator("tr.words span").bounding_box()
        assert box is not None
        assert box["x"] + box["width"] < 390
