"""Pictures of cameras in a real browser: they come late, are seen, and move nothing."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, Route
from tests.server.pages.camera_pictures import keep_pictures, scene_ids
from tests.server.pages.page_site import fill, open_site
from tests.support.browser import axe_violations
from tests.support.serving import served

from exceptiondrive_schemas.board import Board

pytestmark = pytest.mark.browser
SCENES = "/scenes?phase=sample"
SAMPLE = "/entries/s0000000kq/samples/scene-lane_blockage"


@pytest.fixture
def address(tmp_path: Path, migrated_sqlite: Path, lively_board: Board) -> Iterator[str]:
    site = open_site(tmp_path, migrated_sqlite)
    fill(site, lively_board)
    site.publish_split()
    site.keep_drawings("s0000000kq", 1)
    keep_pictures(site, scene_ids())
    with served(site.app) as address:
        yield address
    site.database.dispose()


@pytest.mark.parametrize("width", [1440, 390])
@pytest.mark.parametrize("path", [SCENES, SAMPLE])
def test_pictures_are_seen_and_move_nothing_when_they_come(
    browser: Browser, address: str, path: str, width: int
) -> None:
    page = browser.new_page(viewport={"width": width, "height": 900})
    complaints: list[Any] = []
    page.on("console", lambda message: complaints.append(message.text))
    held: list[Route] = []
    is_held = True

    def answer(route: Route) -> None:
        if is_held:
            held.append(route)
        else:
            route.continue_()

    page.route("**/pictures/*.jpg", answer)
    page.goto(address + path, wait_until="domcontentloaded")
    boxes = "all => all.map(each => { const b = each.getBoundingClientRect(); return [b.width, b.height]; })"
    images = page.locator(".mo-shots img")
    page.locator(".mo-shots").first.scroll_into_view_if_needed()
    while not held:
        page.wait_for_timeout(20)
    before = images.evaluate_all(boxes)
    assert min(min(box) for box in before) > 60
    is_held = False
    for route in held:
        route.continue_()
    for image in images.all():
        image.scroll_into_view_if_needed()
        image.evaluate("image => image.decode()")
    assert images.evaluate_all(boxes) == before
    assert {image.evaluate("image => image.naturalWidth") for image in images.all()} == {64, 60}
    assert (page.evaluate("document.documentElement.scrollWidth")) <= width
    assert complaints == []  # the site's own policy lets them in
    page.close()
    page = browser.new_page(viewport={"width": width, "height": 900}, bypass_csp=True)
    page.goto(address + path)
    assert axe_violations(page) == []
    page.close()
