"""The player in a real browser: by hand, by keyboard, without script, without motion."""

from collections.abc import Iterator
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, expect
from tests.server.pages.invented_board import MANIFEST
from tests.server.pages.page_site import Site, real_drawings
from tests.support.browser import Look, axe_violations, look_at

from exceptiondrive_schemas.board import Board
from exceptiondrive_schemas.drawing import SampleDrawing

pytestmark = pytest.mark.browser
SCENES = "/scenes?phase=sample&with=s0000003kq&with=s0000005kq"
SCENE: SampleDrawing = next(
    each.drawing for each in real_drawings(1).samples if each.chosen_as == "scene"
)


@pytest.fixture
def complaints() -> list[str]:
    return []


@pytest.fixture
def visit(browser: Browser, address: str, complaints: list[str]) -> Iterator[Any]:
    def visited(path: str, **context: Any) -> Page:
        page = browser.new_context(**context).new_page()
        page.on("console", lambda message: complaints.append(message.text))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.goto(address + path)
        return page

    yield visited
    for context in browser.contexts:
        context.close()
    assert complaints == []


def put(page: Page, name: str, value: float) -> None:
    page.locator(f"[data-{name}]").evaluate(
        "(range, value) => { range.value = value; range.dispatchEvent(new Event('input')); }", value
    )


def corners(text: str) -> list[float]:
    return [float(part) for pair in text.split() for part in pair.split(",")]


def swept(page: Page) -> int:
    """How many pieces of the first tube are seen."""
    pieces = page.locator(".mo").first.locator(".r0 .tube > *")
    return sum(bool(piece.get_attribute("points")) for piece in pieces.all())


def test_the_car_moves_the_tube_fills_and_the_number_is_that_of_the_time_step(visit: Any) -> None:
    page = visit(SCENES)
    scene = page.locator(".mo").first
    car, reading = scene.locator(".r0 .mo-car"), scene.locator(".mo-read b").first
    boxes = [corners(box) for box in (car.get_attribute("data-boxes") or "").split(";")]
    assert len(boxes) == 7
    for step, n_swept in ((0, 0), (3, 3), (6, 6)):
        put(page, "time", step * 0.5)
        assert corners(car.get_attribute("points") or "") == pytest.approx(boxes[step], abs=0.06)
        assert swept(page) == n_swept
        expect(reading).to_contain_text(f"{SCENE.clearances_m[step]:.2f} m")
    put(page, "time", 1.7)  # between two steps: the number of the last one, the car on its way
    expect(reading).to_contain_text(f"{SCENE.clearances_m[3]:.2f} m")
    between = [a + (b - a) * 0.4 for a, b in zip(boxes[3], boxes[4], strict=True)]
    assert corners(car.get_attribute("points") or "") == pytest.approx(between, abs=0.06)
    assert swept(page) == 4


def test_play_runs_to_the_end_and_can_be_stopped(visit: Any) -> None:
    page = visit(SCENES)
    button, time = page.locator("[data-play]"), page.locator("[data-time]")
    button.click()
    expect(button).to_have_text("Pause")
    expect(page.locator("output")).to_have_attribute("aria-live", "off")
    button.click()
    expect(button).to_have_text("Play")
    expect(page.locator("output")).to_have_attribute("aria-live", "polite")
    assert float(time.input_value()) < 3
    button.click()
    expect(button).to_have_text("Play", timeout=20_000)
    assert float(time.input_value()) == 3


def test_the_keyboard_scrubs_and_screen_readers_hear_the_time(visit: Any) -> None:
    page = visit(SCENES)
    time = page.locator("[data-time]")
    time.focus()
    page.keyboard.press("Home")
    assert time.get_attribute("aria-valuetext") == "0.0 seconds"
    page.keyboard.press("ArrowRight")
    assert time.get_attribute("aria-valuetext") == "0.1 seconds"
    page.keyboard.press("End")
    assert time.get_attribute("aria-valuetext") == "3.0 seconds"
    picture = page.locator(".mo-top").first.get_attribute("aria-label") or ""
    assert SCENE.hazard in picture
    numbers = page.locator(".mo-line").first.get_attribute("aria-label") or ""
    assert ", ".join(f"{value:.2f}" for value in SCENE.clearances_m) in numbers


def test_the_original_scene_has_no_hazard_and_its_own_path(visit: Any) -> None:
    page = visit(SCENES)
    put(page, "blend", 0)
    scene = page.locator(".mo").first
    assert scene.locator(".mo-hazard").get_attribute("opacity") == "0"
    assert scene.locator(".r0 .mo-after").get_attribute("opacity") == "0"
    put(page, "time", 1.5)
    before = scene.locator(".r0 .mo-before")
    boxes = (before.get_attribute("data-boxes") or "").split(";")
    assert corners(before.get_attribute("points") or "") == pytest.approx(
        corners(boxes[3]), abs=0.06
    )
    assert before.get_attribute("opacity") == "1"
    put(page, "blend", 100)
    assert scene.locator(".mo-hazard").get_attribute("opacity") == "1"


def test_who_wants_no_motion_goes_step_by_step(visit: Any) -> None:
    page = visit(SCENES, reduced_motion="reduce")
    button, time = page.locator("[data-play]"), page.locator("[data-time]")
    expect(button).to_have_text("Next step")
    for seconds in ("0", "0.5", "1"):
        button.click()
        expect(button).to_have_text("Next step")
        assert time.input_value() == seconds


def test_what_is_chosen_by_is_not_printed(visit: Any) -> None:
    page = visit(SCENES)
    page.emulate_media(media="print")
    assert page.locator(".mo").first.is_visible()
    assert page.locator(".mo-form").is_hidden()


def test_without_script_everything_stands_still_at_the_end(visit: Any) -> None:
    page = visit(SCENES, java_script_enabled=False)
    assert page.locator("[data-play]").is_hidden()
    scene = page.locator(".mo").first
    assert scene.locator(".r0 .mo-car").is_visible()
    assert (
        scene.locator(".mo-read b").first.inner_text().startswith(f"{SCENE.clearances_m[-1]:.2f} m")
    )
    page.select_option("select[name=with] >> nth=1", "")
    with page.expect_navigation():
        page.click(".mo-form button")
    assert page.locator(".mo").first.locator(".mo-run").count() == 2
    board = visit("/?phase=sample", java_script_enabled=False)
    still = board.locator(".mo-still img")
    still.scroll_into_view_if_needed()
    assert still.is_visible()


def test_the_board_takes_the_player_when_it_comes_into_sight_and_others_join_in_place(
    visit: Any,
) -> None:
    page = visit("/?phase=sample", viewport={"width": 1440, "height": 900})
    page.evaluate("document.getElementById('scenes').scrollIntoView()")
    page.locator("#scenes .mo").first.wait_for()
    assert page.locator("#scenes .mo").count() == 6
    page.select_option("#scenes select[name=with] >> nth=0", "s0000003kq")
    page.click(".mo-form button")
    expect(page.locator("#scenes .mo").first.locator(".mo-run")).to_have_count(2)
    assert page.url.endswith("/?phase=sample")
    assert page.locator("h1").count() == 1


def test_scenes_that_come_later_leave_the_words_above_them(
    visit: Any, shown_site: Site, lively_board: Board
) -> None:
    withheld = MANIFEST.model_copy(update={"name": "kept", "revision": "sha256:" + "7" * 64})
    shown_site.create_phase("final", manifest=withheld)
    leader = lively_board.entries[0].model_copy(update={"submission_id": "f0000000kq"})
    update = {"phase": "final", "entries": (leader,), "split": withheld.ref}
    shown_site.publish(lively_board.model_copy(update=update))
    page = visit("/entries/f0000000kq?phase=final")
    page.locator("#scenes").scroll_into_view_if_needed()
    page.locator("#scenes .mo").first.wait_for()
    assert page.inner_text("#scenes h2") == "Scenes like these"
    assert "the planner in them is not this entry" in page.inner_text("#scenes")
    assert page.locator("main section").last.get_attribute("id") == "scenes"


@pytest.mark.parametrize("motion", ["no-preference", "reduce"])
@pytest.mark.parametrize("width", [390, 1440])
def test_a_link_past_the_scenes_stops_at_its_heading(visit: Any, width: int, motion: str) -> None:
    look = {"viewport": {"width": width, "height": 700}, "reduced_motion": motion}
    page = visit("/?phase=sample#families", **look)
    stops_at(page, "families")
    page = visit("/?phase=sample", **look)
    page.click(".foot a[href='#about']")
    stops_at(page, "about")


def stops_at(page: Page, anchor: str) -> None:
    """Wait until the page rests, scenes that come late included: the anchor stands under the header."""
    top = f"Math.round(document.getElementById('{anchor}').getBoundingClientRect().top)"
    seen = [None, page.evaluate(top)]
    while seen[-1] != seen[-2] or len(seen) < 4:
        page.wait_for_timeout(400)
        seen.append(page.evaluate(top))
    assert abs(seen[-1] - 76) <= 1, seen


def test_axe_finds_nothing_and_nothing_is_too_small_or_too_wide(visit: Any) -> None:
    page = visit(SCENES, bypass_csp=True)  # axe is a script
    looks: tuple[Look, ...] = ((390, "light"), (390, "dark"), (1440, "light"), (1440, "dark"))
    for look in looks:
        look_at(page, look)
        assert axe_violations(page) == [], look
        assert page.evaluate("document.documentElement.scrollWidth") <= look[0]
        sizes = page.locator(".mo text").evaluate_all(
            "texts => texts.map((each) => parseFloat(getComputedStyle(each).fontSize) * each.getCTM().a)"
        )
        assert min(sizes) >= 10
