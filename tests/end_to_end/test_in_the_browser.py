"""A team in a real browser, before every real part: sign in, submit, watch it become ranked."""

from __future__ import annotations

import gzip
import json
import re
from typing import TYPE_CHECKING

import pytest
from playwright.sync_api import Browser, BrowserContext, Page, expect
from tests.support.processes import wait_until

if TYPE_CHECKING:
    from pathlib import Path

    from tests.support.system import System

pytestmark = [
    pytest.mark.browser,
    pytest.mark.slow,
]
LONGEST_MS = 180_000


@pytest.fixture(scope="module")
def team_token(sample_system: System) -> str:
    """A team, as an operator makes it."""
    return sample_system.make_team("browsing")


@pytest.fixture(scope="module")
def planner(sample_system: System) -> Path:
    """A file of a synthetic planner, not compressed."""
    kept = sample_system.data / "sample" / "planners" / "bypass-planner.json.gz"
    wait_until(kept.is_file, "the sample's files")
    wait_until(lambda: sample_system.get("/phases"), "the sample's phases")
    written = sample_system.data / "mine.json"
    written.write_text(json.dumps(json.loads(gzip.decompress(kept.read_bytes())), indent=1))
    return written


def sign_in(context: BrowserContext, system: System, token: str) -> Page:
    page = context.new_page()
    page.goto(f"{system.url}/my")
    page.fill("input[name=token]", token)
    page.click("text=Sign in >> visible=true >> nth=-1")
    page.wait_for_url("**/my")
    return page


def submit(page: Page, system: System, file: Path, method: str) -> None:
    page.goto(f"{system.url}/submit")
    page.set_input_files("input[name=file]", file)
    page.fill("input[name=method]", method)
    page.click("form.upload button")
    page.wait_for_url(re.compile(r"/submissions/[0-9a-z]{16}$"))


def test_a_team_submits_and_watches_it_become_ranked(
    browser: Browser, sample_system: System, team_token: str, planner: Path
) -> None:
    complaints: list[str] = []
    context = browser.new_context(viewport={"width": 1360, "height": 900}, color_scheme="dark")
    page = sign_in(context, sample_system, team_token)
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("console", lambda message: complaints.append(message.text))
    submit(page, sample_system, planner, "Watched")
    page.evaluate("window.isStillTheSamePage = true")
    expect(page.locator(".way-rank")).to_be_visible(timeout=LONGEST_MS)
    assert page.evaluate("window.isStillTheSamePage"), "it was followed without a reload"
    page.click("text=Entry on the board")
    expect(page.locator("h1")).to_have_text("Watched")
    page.goto(f"{sample_system.url}/my")
    expect(page.locator(".subs .badge.scored")).to_be_visible()
    assert complaints == []
    context.close()


def test_without_script_on_a_phone_a_file_goes_through_the_form_to_a_rank(
    browser: Browser, sample_system: System, team_token: str, planner: Path, tmp_path: Path
) -> None:
    context = browser.new_context(viewport={"width": 390, "height": 844}, java_script_enabled=False)
    page = sign_in(context, sample_system, team_token)
    page.goto(f"{sample_system.url}/submit?phase=sample")
    empty = tmp_path / "empty.json"
    empty.write_bytes(b"")
    page.fill("input[name=method]", "Without script")
    page.fill("textarea[name=description]", "Typed once.")
    page.set_input_files("input[name=file]", empty)
    page.click("form.upload button")
    expect(page.locator(".refused")).to_contain_text("The file holds nothing")
    expect(page.locator("input[name=method]")).to_have_value("Without script")
    expect(page.locator("textarea[name=description]")).to_have_value("Typed once.")
    own = tmp_path / "own.json"
    document = json.loads(planner.read_text())
    document["predictions"][0]["edited"] = None
    own.write_text(json.dumps(document))
    page.set_input_files("input[name=file]", own)
    page.click("form.upload button")
    page.wait_for_url(re.compile(r"/submissions/[0-9a-z]{16}$"))
    expect(page.locator(".way-rank")).to_be_visible(timeout=LONGEST_MS)
    page.click("text=Entry on the board")
    expect(page.locator("h1")).to_have_text("Without script")
    context.close()


def test_a_wrong_file_shows_the_list_that_the_client_prints(
    browser: Browser, sample_system: System, team_token: str, planner: Path, tmp_path: Path
) -> None:
    document = json.loads(planner.read_text())
    document["predictions"][0]["edited"] = document["predictions"][0]["edited"][:4]
    document["predictions"][1]["source"][2] = [1.0, 900.0]
    del document["predictions"][2]
    wrong = tmp_path / "wrong.json"
    wrong.write_text(json.dumps(document))
    manifest = tmp_path / "manifest.json"
    fetched = sample_system.client("manifest", "sample", "-o", manifest, token=team_token)
    assert fetched.returncode == 0, fetched.stderr
    printed = sample_system.client("check", wrong, "--manifest", manifest, "--json")
    assert printed.returncode == 2
    faults = json.loads(printed.stdout)["faults"]
    context = browser.new_context(viewport={"width": 390, "height": 844}, java_script_enabled=False)
    page = sign_in(context, sample_system, team_token)
    submit(page, sample_system, wrong, "Wrong")
    expect(page.locator(".flt")).to_be_visible(timeout=LONGEST_MS)
    assert page.locator(".flt .fgrp code:first-child").first.inner_text() == faults[0]["code"]
    text = page.locator(".flt").inner_text()
    assert len(faults) >= 3
    for fault in faults:
        assert fault["code"] in text
        for example in fault["examples"]:
            assert example["path"] in text
    context.close()
