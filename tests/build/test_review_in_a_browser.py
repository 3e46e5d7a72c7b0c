"""The review page in a real browser: keys, corners, blind readers, a third one, a killed browser."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import Browser, Page, ViewportSize, expect
from playwright.sync_api import Error as PlaywrightError
from tests.build.shop import ground_polygon, make_shop
from tests.support.browser import NAMES, Look, axe_violations, look_at
from tests.support.serving import served

from exceptiondrive_build.agreement import outcome
from exceptiondrive_build.candidates import Candidate, walk
from exceptiondrive_build.records import Kind, Record
from exceptiondrive_build.review_page.app import review_app
from exceptiondrive_build.review_page.desk import Desk
from exceptiondrive_build.review_page.leases import Holder
from exceptiondrive_build.values import Corners, Edited, Verified
from exceptiondrive_build.workshop import Workshop, new_workshop
from exceptiondrive_schemas.taxonomy import RegionKind

pytestmark = [pytest.mark.browser, pytest.mark.slow]
WIDE: ViewportSize = {"width": 1440, "height": 900}
TABLET: ViewportSize = {"width": 820, "height": 1180}


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_shop(tmp_path_factory.mktemp("small"))


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """105 cards to inspect."""
    return make_shop(tmp_path_factory.mktemp("large"), n_scenes=5, width_px=96)


class Site:
    def __init__(self, address: str, shop: Path, keys: list[str]) -> None:
        self.address, self.shop, self.keys = address, shop, keys

    def reviewer(self, browser: Browser, name: str, **context: Any) -> Page:
        """Somebody who opened the address and signed in."""
        options = {"viewport": WIDE, "bypass_csp": True, **context}
        page = browser.new_context(**options).new_page()
        page.on("pageerror", lambda error: pytest.fail(f"{name}: {error}"))
        page.goto(f"{self.address}/open/{self.keys[-1]}")
        page.fill("#name", name)
        page.keyboard.press("Enter")
        page.wait_for_selector("text=Agreement of blind readers")
        return page

    def records(self, kind: Kind) -> list[Record]:
        with Workshop(self.shop) as workshop:
            return list(workshop.records.read(kind))

    def candidates(self) -> dict[str, Candidate]:
        with Workshop(self.shop) as workshop:
            return walk(workshop)


@contextmanager
def site_of(shop: Path, lease_s: float = 60) -> Iterator[Site]:
    keys: list[str] = []
    with served(review_app(shop, keys.append, lease_s=lease_s)) as address:
        yield Site(address, shop, keys)


@pytest.fixture
def site(small: Path, tmp_path: Path) -> Iterator[Site]:
    with site_of(shutil.copytree(small, tmp_path / "shop")) as site:
        yield site


def card_of(page: Page) -> str:
    """Id of the card on the screen."""
    return str(page.evaluate("document.body.dataset.card"))


def begin(page: Page, queue: str) -> str:
    page.goto(f"{page.url.split('/', 3)[0]}//{page.url.split('/', 3)[2]}/{queue}")
    page.wait_for_selector("#card:not([hidden])")
    await_pictures(page)
    return card_of(page)


def await_pictures(page: Page) -> None:
    """Wait until the edited views are there: before, no decision is taken."""
    page.wait_for_function(
        "[...document.querySelectorAll('.thumb.is-edited img')]"
        ".every(one => one.complete && one.naturalWidth)"
    )


def press(page: Page, *keys: str) -> None:
    for key in keys:
        page.keyboard.press(key)


def decide(page: Page, *keys: str) -> str:
    """Press keys and wait for the next card, or the end; return the card that was decided."""
    before = card_of(page)
    press(page, *keys)
    page.wait_for_function(
        "before => document.body.dataset.card !== before || document.getElementById('card').hidden",
        arg=before,
    )
    await_pictures(page)
    return before


def is_at_end(page: Page) -> bool:
    return page.locator("#empty").is_visible()


def test_two_decide_a_hundred_cards_by_keyboard_and_none_is_lost_or_given_twice(
    large: Path, tmp_path: Path, browser: Browser
) -> None:
    with site_of(shutil.copytree(large, tmp_path / "shop")) as site:
        people = {name: site.reviewer(browser, name) for name in ("ada", "grace")}
        for page in people.values():
            begin(page, "inspect")
        decided: dict[str, list[str]] = {"ada": [], "grace": []}
        while any(not is_at_end(page) for page in people.values()):
            for name, page in people.items():
                if is_at_end(page) or page.locator("#card").is_hidden():
                    page.wait_for_timeout(50)
                    continue
                place = len(decided[name])
                keys = ("r", "5") if place % 7 == 3 else ("a",)
                if place == 2:
                    press(page, "n", *"seen", "Escape")
                decided[name].append(decide(page, *keys))
        for page in people.values():
            expect(page.locator("#empty-words")).to_have_text(
                "Every card of this queue is decided."
            )
        records = site.records(Kind.INSPECT)
    cards = decided["ada"] + decided["grace"]
    assert len(cards) == len(set(cards)) == 105
    assert {record.candidate for record in records} == set(cards)
    assert len(records) == 105
    for name, mine in decided.items():
        told = [record.value or {} for record in records if record.by.person == name]
        assert [r.candidate for r in records if r.by.person == name] == mine
        assert len(mine) > 30
        assert [value["passed"] for value in told] == [i % 7 != 3 for i in range(len(mine))]
        assert told[3]["reason"] == "source_preservation"
        assert told[2]["note"] == "seen"


def test_holding_flips_all_views_swiping_parts_them_and_zoom_moves_both(
    site: Site, browser: Browser
) -> None:
    page = site.reviewer(browser, "ada")
    begin(page, "inspect")
    expect(page.locator("#task")).to_have_attribute("aria-live", "polite")
    edited = page.locator("#focus .edited")
    expect(page.locator("#shown")).to_have_text("edited")
    page.keyboard.down(" ")
    expect(page.locator("#shown")).to_have_text("source")
    for view in (edited, page.locator(".thumb.is-edited .edited").first):
        assert view.evaluate("one => getComputedStyle(one).visibility") == "hidden"
    page.keyboard.up(" ")
    assert edited.evaluate("one => getComputedStyle(one).visibility") == "visible"
    page.keyboard.down("F")
    expect(page.locator("#shown")).to_have_text("source")
    page.keyboard.up("F")
    expect(page.locator("#shown")).to_have_text("edited")
    press(page, "w", "w")
    expect(page.locator("#shown")).to_have_text("edited | source")
    assert "50%" in edited.evaluate("one => getComputedStyle(one).clipPath")
    before = [page.locator(f"#focus .{kind}").bounding_box() for kind in ("source", "edited")]
    press(page, "+", "+", "ArrowLeft")
    after = [page.locator(f"#focus .{kind}").bounding_box() for kind in ("source", "edited")]
    assert before[0] == before[1]
    assert after[0] == after[1]
    assert after[0] is not None
    assert before[0] is not None
    assert after[0]["width"] == pytest.approx(before[0]["width"] * 2.25)
    press(page, "0", "5")
    expect(page.locator("#view-name")).to_have_text("back")
    expect(page.locator("#shown")).to_have_text("not edited")
    box = page.locator("#focus").bounding_box()
    assert box is not None
    press(page, "2")
    page.mouse.move(box["x"] + 50, box["y"] + 50)
    page.mouse.down()
    expect(page.locator("#shown")).to_have_text("source")
    page.mouse.up()


def test_the_pictures_of_the_next_card_are_there_before_it(site: Site, browser: Browser) -> None:
    page = site.reviewer(browser, "ada")
    begin(page, "inspect")
    page.wait_for_load_state("networkidle")
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    decide(page, "a")
    page.wait_for_function(
        "[...document.querySelectorAll('#focus img')].every(one => one.complete)"
    )
    shown = page.locator("#focus .edited").get_attribute("src")
    assert shown is not None
    fetched = [
        entry
        for entry in page.evaluate(
            "name => performance.getEntriesByName(new URL(name, location).href)"
            ".map(one => one.startTime)",
            shown,
        )
    ]
    assert fetched
    assert not any(url.endswith(shown) for url in asked)


def drawn(page: Page) -> np.ndarray[Any, Any]:
    """Corners of the region in the picture, as the browser draws them."""
    points = page.locator("#focus .over .region").get_attribute("points") or ""
    return np.array([[float(value) for value in pair.split(",")] for pair in points.split()])


def corners_on_screen(page: Page) -> Corners:
    values = [
        [float(page.locator(f"[data-corner='{c}'][data-axis='{a}']").input_value()) for a in (0, 1)]
        for c in range(4)
    ]
    a, b, c, d = ((x, y) for x, y in values)
    return a, b, c, d


def test_a_moved_corner_is_projected_into_the_view_at_once_and_kept(
    site: Site, browser: Browser
) -> None:
    page = site.reviewer(browser, "ada")
    sample_id = begin(page, "verify")
    camera = site.candidates()[sample_id].keyframe.camera("CAM_FRONT")
    start = corners_on_screen(page)
    assert drawn(page) == pytest.approx(ground_polygon(camera, np.array(start)), abs=0.02)
    press(page, "ArrowUp", "Shift+ArrowLeft", "c", "ArrowDown", "c", "c", "c", "ArrowRight", "[")
    moved = corners_on_screen(page)
    assert moved != start
    assert drawn(page) == pytest.approx(ground_polygon(camera, np.array(moved)), abs=0.02)
    handle = page.locator("[data-place='2']").bounding_box()
    assert handle is not None
    x, y = handle["x"] + handle["width"] / 2, handle["y"] + handle["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 30, y - 40, steps=4)
    page.mouse.up()
    dragged = corners_on_screen(page)
    assert dragged[2][0] > moved[2][0] + 0.3
    assert dragged[2][1] < moved[2][1] - 0.3
    assert dragged[:2] == moved[:2]
    assert drawn(page) == pytest.approx(ground_polygon(camera, np.array(dragged)), abs=0.02)
    expect(page.locator("#numbers")).to_contain_text("the recorded drive meets it")
    page.fill("[data-corner='0'][data-axis='0']", "13.25")
    page.locator("[data-corner='0'][data-axis='0']").press("Escape")
    press(page, "z")
    assert corners_on_screen(page) == dragged
    press(page, "C", "ArrowUp", "Z")  # as with caps lock
    assert corners_on_screen(page) == dragged
    press(page, "X", "P")
    assert corners_on_screen(page) == start
    press(page, "z", "L", "V", "K", "T", "a")
    expect(page.locator("#notice")).to_contain_text("Say what you checked")
    decide(page, "l", "t", "a")
    (record,) = site.records(Kind.VERIFY)
    value = record.value or {}
    assert record.candidate == sample_id
    assert np.array(value["corners"]) == pytest.approx(np.array(dragged))
    assert value["checked"] == ["location", "task"]
    assert value["blind"] is True


def test_a_region_that_cannot_be_scored_is_said_and_stays_on_the_screen(
    site: Site, browser: Browser
) -> None:
    page = site.reviewer(browser, "ada")
    sample_id = begin(page, "verify")
    page.fill("[data-corner='0'][data-axis='1']", "9")
    page.locator("[data-corner='0'][data-axis='1']").press("Escape")
    expect(page.locator("#numbers")).to_contain_text("it crosses or touches itself")
    press(page, "x", "a")
    expect(page.locator("#notice")).to_contain_text("crosses or touches itself")
    assert card_of(page) == sample_id
    assert site.records(Kind.VERIFY) == []
    press(page, "p")
    decide(page, "a")
    assert len(site.records(Kind.VERIFY)) == 1


def test_two_blind_readers_a_third_one_and_undo(site: Site, browser: Browser) -> None:
    answers: list[dict[str, Any]] = []

    def listen(response: Any) -> None:
        if response.url.endswith("/api/verify/claim"):
            answers.append(response.json())

    ada = site.reviewer(browser, "ada")
    disputed = begin(ada, "verify")
    decide(ada, *"cccc", *["Shift+ArrowUp"] * 4, "x", "a")
    agreed = decide(ada, "x", "a")
    refused = decide(ada, "r", "4")
    expect(ada.locator("#pace")).to_contain_text("0 of 21 decided · 3 by you")
    grace = site.reviewer(browser, "grace")
    grace.on("response", listen)
    assert begin(grace, "verify") == disputed
    proposal = site.candidates()[disputed].localized
    assert proposal is not None
    on_screen = np.array(corners_on_screen(grace))
    assert on_screen == pytest.approx(np.array(proposal.corners), abs=0.006)
    decide(grace, "x", "a")
    decide(grace, "x", "a")
    decide(grace, "r", "1")
    assert all(card["others"] == [] for answer in answers for card in answer["cards"])
    assert disputed in {card["id"] for answer in answers for card in answer["cards"]}

    press(grace, "u")
    expect(grace.locator("#notice")).to_contain_text("Taken back")
    assert card_of(grace) == refused
    decide(grace, "r", "4")

    lin = site.reviewer(browser, "lin")
    seen = [begin(lin, "verify")]
    expect(lin.locator("#third")).to_be_visible()
    expect(lin.locator("#others li")).to_have_count(2)
    expect(lin.locator("#map .other")).to_have_count(2)
    expect(lin.locator("#focus .over .other")).to_have_count(2)
    assert seen == [disputed]
    decide(lin, "ArrowUp", "x", "a")
    assert card_of(lin) not in (disputed, agreed, refused)

    candidates = site.candidates()
    with Workshop(site.shop) as workshop:
        limits = workshop.settings.verify
    found = {
        card: outcome(candidates[card].verifications, limits)
        for card in (disputed, agreed, refused)
    }
    assert [found[card].state for card in (disputed, agreed, refused)] == [
        "verified",
        "verified",
        "rejected",
    ]
    assert found[agreed].corners == candidates[agreed].localized.corners  # type: ignore[union-attr]
    values = [record.value for record in site.records(Kind.VERIFY)]
    assert values.count(None) == 1
    lin.goto(site.address)
    expect(lin.locator("text=Read by two")).to_be_visible()


def test_two_who_never_agree_are_told_what_the_cards_wait_for(
    small: Path, tmp_path: Path, browser: Browser
) -> None:
    shop = shutil.copytree(small, tmp_path / "shop")
    with Workshop(shop) as workshop:
        desk = Desk(workshop, lease_s=60)
        for holder, accepted in ((Holder("1", "ada"), True), (Holder("2", "grace"), False)):
            for card in desk.claim("verify", holder, 99):
                localized = desk.candidates[card].localized
                assert localized is not None
                corners = localized.corners if accepted else None
                word = Verified(accepted=accepted, corners=corners, checked=("location",))
                desk.decide("verify", card, holder, word)
        desk.leases.close()
    with site_of(shop) as site:
        for name in ("ada", "grace"):
            page = site.reviewer(browser, name)
            expect(page.locator("text=On 21 two readers differ: a third decides.")).to_be_visible()
            page.goto(f"{site.address}/verify")
            expect(page.locator("#empty-words")).to_have_text(
                "21 cards are waiting for another reader: you have read them. "
                "On 21 two readers differ: a third decides, who must be somebody else."
            )
            assert axe_violations(page) == []
        begin(site.reviewer(browser, "lin"), "verify")


def test_a_queue_that_nothing_has_reached_says_so(tmp_path: Path, browser: Browser) -> None:
    new_workshop(tmp_path / "shop", "made-2027", "0" * 64)
    with site_of(tmp_path / "shop") as site:
        page = site.reviewer(browser, "ada")
        page.goto(f"{site.address}/verify")
        expect(page.locator("#empty-words")).to_contain_text("No candidate has come this far yet")


def test_the_cards_of_a_killed_browser_come_to_another(
    small: Path, tmp_path: Path, browser: Browser
) -> None:
    chromium = next(found for name in NAMES if (found := shutil.which(name)))
    doomed = browser.browser_type.launch(executable_path=chromium, args=["--no-sandbox"])
    with site_of(shutil.copytree(small, tmp_path / "shop"), lease_s=2) as site:
        ada, grace = site.reviewer(doomed, "ada"), site.reviewer(browser, "grace")
        begin(ada, "inspect")
        kept = decide(ada, "a")
        lost = card_of(ada)
        with suppress(PlaywrightError):  # there is nobody left to answer
            doomed.new_browser_cdp_session().send("Browser.crash")
        assert not doomed.is_connected()
        begin(grace, "inspect")
        seen: list[str] = []
        while len(seen) < 20:
            grace.wait_for_selector("#card:not([hidden])")
            seen.append(decide(grace, "a"))
        assert lost in seen
        assert kept not in seen
        assert len(set(seen)) == 20
        expect(grace.locator("#empty")).to_be_visible()
        assert len(site.records(Kind.INSPECT)) == 21


def test_what_is_not_kept_stays_on_the_screen_until_it_is(site: Site, browser: Browser) -> None:
    page = site.reviewer(browser, "ada")
    before = begin(page, "inspect")
    page.wait_for_load_state("networkidle")
    page.context.set_offline(True)
    press(page, "n", *"mine", "Escape", "a")
    expect(page.locator("#notice")).to_contain_text("Your decision is still here")
    assert card_of(page) == before
    page.context.set_offline(False)
    decide(page, "a")
    (record,) = site.records(Kind.INSPECT)
    assert (record.candidate, (record.value or {})["note"]) == (before, "mine")


def test_a_key_that_is_held_decides_one_card(site: Site, browser: Browser) -> None:
    page = site.reviewer(browser, "ada")
    begin(page, "inspect")
    for keys in (("a",), ("r", "5")):
        before = card_of(page)
        press(page, *keys[:-1])
        for _ in range(20):
            page.keyboard.down(keys[-1])
            await_pictures(page)
        page.keyboard.up(keys[-1])
        page.wait_for_function("before => document.body.dataset.card !== before", arg=before)
    page.focus("#accept")
    for _ in range(20):
        page.keyboard.down("Enter")
        await_pictures(page)
    page.keyboard.up("Enter")
    expect(page.locator("#pace")).to_contain_text("3 of 21 decided")
    assert [(it.value or {})["passed"] for it in site.records(Kind.INSPECT)] == [True, False, True]


def test_single_key_shortcuts_are_turned_off_and_stay_off(site: Site, browser: Browser) -> None:
    """What a program for dictation types decides nothing (WCAG 2.1.4)."""
    page = site.reviewer(browser, "ada")
    before = begin(page, "inspect")
    page.click("#help-open")
    page.get_by_label("Single-key shortcuts").uncheck()
    press(page, "Escape")
    assert begin(page, "inspect") == before
    press(page, "a", "s", "r", "5", "?")
    expect(page.locator("#help, #reasons").locator("visible=true")).to_have_count(0)
    assert (card_of(page), site.records(Kind.INSPECT)) == (before, [])
    page.focus("#accept")
    assert decide(page, "Enter") == before


def test_where_an_edited_picture_is_missing_nothing_stands_in_and_nothing_is_decided(
    site: Site, browser: Browser
) -> None:
    ada = site.reviewer(browser, "ada")
    sample_id = begin(ada, "inspect")
    edited = site.candidates()[sample_id].edited
    assert isinstance(edited, Edited)
    lost = site.shop / "images" / edited.images["CAM_FRONT"]
    lost.rename(site.shop / "elsewhere")
    page = site.reviewer(browser, "grace")
    ada.goto(site.address)  # gives the card back
    page.goto(f"{site.address}/inspect")
    page.wait_for_selector("#card:not([hidden])")
    page.wait_for_load_state("networkidle")
    assert card_of(page) == sample_id
    with Image.open(BytesIO(page.locator("#focus").screenshot())) as shown:
        assert shown.convert("RGB").getpixel((shown.width // 2, shown.height // 4)) == (0, 0, 0)
    for keys in ("a", "r5"):
        press(page, *keys)
        expect(page.locator("#notice")).to_contain_text("A picture of this card is missing")
    assert site.records(Kind.INSPECT) == []
    (site.shop / "elsewhere").rename(lost)
    begin(page, "inspect")
    decide(page, "a")
    assert [record.candidate for record in site.records(Kind.INSPECT)] == [sample_id]


def test_readers_are_asked_by_the_kind_of_region(site: Site, browser: Browser) -> None:
    page = site.reviewer(browser, "ada")
    begin(page, "verify")
    kinds = set()
    for candidate in site.candidates().values():
        expect(page.locator("#hazard")).to_have_text(candidate.task.hazard)
        is_space = candidate.task.region is RegionKind.PHYSICAL
        asked = "the space that the hazard takes?" if is_space else "the no-go area"
        expect(page.locator("#kind")).to_contain_text(asked)
        kinds.add(is_space)
        decide(page, "s")
    assert kinds == {True, False}


def test_corners_are_moved_and_pictures_flipped_by_touch(site: Site, browser: Browser) -> None:
    page = site.reviewer(browser, "ada", viewport=TABLET, has_touch=True)
    sample_id = begin(page, "verify")
    before = corners_on_screen(page)
    fingers = page.context.new_cdp_session(page)

    def touch(kind: str, *points: tuple[float, float]) -> None:
        at = [{"x": x, "y": y} for x, y in points]
        fingers.send("Input.dispatchTouchEvent", {"type": f"touch{kind}", "touchPoints": at})

    box = page.locator("[data-place='3']").bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2 + 12, box["y"] + box["height"] / 2  # beside, within a finger
    touch("Start", (x, y))
    for step in range(1, 5):
        touch("Move", (x + 10 * step, y - 8 * step))
    touch("End")
    after = corners_on_screen(page)
    assert after[:3] == before[:3]
    assert after[3][0] > before[3][0] + 0.5
    assert after[3][1] < before[3][1] - 0.5
    frame = page.locator("#focus").bounding_box()
    assert frame is not None
    x, y = frame["x"] + frame["width"] / 2, frame["y"] + frame["height"] / 2
    touch("Start", (x, y))
    expect(page.locator("#shown")).to_have_text("source")
    touch("End")
    expect(page.locator("#shown")).to_have_text("edited")
    touch("Start", (x - 20, y))
    touch("Start", (x - 20, y), (x + 20, y))
    for step in range(1, 5):
        touch("Move", (x - 20 - 8 * step, y), (x + 20 + 8 * step, y))
    touch("End")
    wide = page.locator("#focus .edited").bounding_box()
    assert wide is not None
    assert wide["width"] > frame["width"] * 1.5
    page.tap("text=calibration")
    page.tap("#accept")
    page.wait_for_function("before => document.body.dataset.card !== before", arg=sample_id)
    (record,) = site.records(Kind.VERIFY)
    assert record.candidate == sample_id
    assert (record.value or {})["checked"] == ["calibration"]


def test_axe_finds_nothing_and_no_page_is_wider_than_the_screen(
    site: Site, browser: Browser
) -> None:
    page = browser.new_context(viewport=WIDE, bypass_csp=True).new_page()
    looks: tuple[Look, ...] = ((820, "light"), (820, "dark"), (1440, "dark"), (1440, "light"))

    def complaints() -> list[str]:
        said = []
        for look in looks:
            look_at(page, look)
            wider = page.evaluate("document.documentElement.scrollWidth - window.innerWidth")
            said += [f"{look}: {wider} px too wide"] if wider > 0 else []
            for one in axe_violations(page):
                said.append(f"{look}: {one['id']}: {one['nodes'][0]['html'][:160]}")
        return said

    key = site.keys[-1]
    page.goto(site.address)
    assert complaints() == []
    page.goto(f"{site.address}/open/{key}")
    assert complaints() == []
    page.fill("#name", "ada")
    page.keyboard.press("Enter")
    page.wait_for_selector("text=Agreement of blind readers")
    page.click("#address")
    expect(page.locator("#made")).to_contain_text("/open/")
    assert complaints() == []
    for queue in ("inspect", "verify"):
        begin(page, queue)
        assert complaints() == []
        press(page, "r")
        expect(page.locator("#reasons")).to_be_visible()
        assert complaints() == []
        press(page, "Escape", "?")
        expect(page.locator("#help")).to_be_visible()
        assert complaints() == []
