"""A pytest plugin: the Chromium of this machine, headless, and axe to look at its pages."""

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import pytest
from playwright.sync_api import Browser, Page, sync_playwright

AXE = Path(__file__).parents[1] / "server" / "pages" / "vendor" / "axe.min.js"
NAMES = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")
"""The shell first: the same pages for a third of the processor time."""


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """A headless Chromium of this machine; contexts that a test leaves open end with its module.

    It lives no longer than a module: while it does, no test may have an event loop of its own.
    """
    chromium = next((found for name in NAMES if (found := shutil.which(name))), None)
    if chromium is None:
        pytest.skip("no Chromium is installed on this machine")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=chromium, args=["--no-sandbox", "--disable-gpu"]
        )
        yield browser
        browser.close()


Look = tuple[int, Literal["light", "dark"]]


def look_at(page: Page, look: Look) -> None:
    """Give a page that is open another width, and another theme of the system."""
    width, scheme = look
    page.set_viewport_size({"width": width, "height": 900})
    page.emulate_media(color_scheme=scheme)


def axe_violations(page: Page) -> list[dict[str, Any]]:
    """Return what axe finds wrong on a page."""
    if not page.evaluate("'axe' in window"):
        page.add_script_tag(path=AXE)
        page.context.add_init_script(path=AXE)  # for the pages after it
    found: list[dict[str, Any]] = page.evaluate("axe.run(document, {resultTypes: ['violations']})")[
        "violations"
    ]
    return found
