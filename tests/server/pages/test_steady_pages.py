"""Pages stand still: fonts that come late move nothing."""

import pytest
from playwright.sync_api import Browser, Route

pytestmark = pytest.mark.browser
MAX_SHIFT = 0.02
PATHS = (
    "/", "/?phase=strategy", "/?phase=unpublished", "/entries/s0000000kq", "/compare",
    "/protocols/1.0", "/splits/sample", "/submit", "/history?phase=sample", "/api", "/problems",
)  # fmt: skip
WATCH = """
window.shift = 0;
new PerformanceObserver((list) => {
  for (const entry of list.getEntries()) if (!entry.hadRecentInput) shift += entry.value;
}).observe({type: "layout-shift", buffered: true});
"""


@pytest.mark.parametrize("width", [1440, 390])
@pytest.mark.parametrize("path", PATHS)
def test_fonts_that_come_late_move_nothing(
    browser: Browser, address: str, path: str, width: int
) -> None:
    context = browser.new_context(viewport={"width": width, "height": 900})
    page = context.new_page()
    late: list[Route] = []
    page.route("**/*.woff2*", lambda route: late.append(route))
    page.add_init_script(WATCH)
    page.goto(address + path, wait_until="domcontentloaded")
    while not page.evaluate("performance.getEntriesByName('first-contentful-paint').length"):
        page.wait_for_timeout(50)
    page.wait_for_timeout(300)
    assert late, "no font was asked for"
    for route in late:
        route.continue_()
    page.evaluate("document.fonts.ready.then(() => 0)")
    page.wait_for_timeout(300)
    shift = page.evaluate("shift")
    context.close()
    assert shift < MAX_SHIFT
