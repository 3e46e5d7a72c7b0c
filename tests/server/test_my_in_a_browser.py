"""My submissions in a real browser: place in the queue, quota, and live status over both ways."""

import re
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import pytest
from playwright.sync_api import Browser, Page, expect
from sqlalchemy import func, select
from tests.support.serving import served

from exceptiondrive_records.audit.tables import AuditLine

if TYPE_CHECKING:
    from tests.support.application import Api

pytestmark = [pytest.mark.browser, pytest.mark.slow]
LONGEST_MS = 30_000
_INK_OF_HARM = """() => {
    const probe = document.body.appendChild(document.createElement("i"));
    probe.className = "spent";
    return getComputedStyle(probe).color;
}"""


@pytest.fixture
def address(api: "Api") -> Iterator[str]:
    """The application on a port of its own; nothing scores, so that submissions wait."""
    with served(api.app, lifespan="off") as address:
        yield address


@pytest.fixture
def my_page(browser: Browser, api: "Api", address: str) -> Iterator[Callable[..., Page]]:
    """Signs team Alpha in and opens its list; `blocked` keeps events away from the browser."""
    contexts = []

    def open_page(*, blocked: bool = False) -> Page:
        context = browser.new_context(viewport={"width": 390, "height": 844})
        contexts.append(context)
        page = context.new_page()
        if blocked:
            page.route("**/events", lambda route: route.abort())
        page.goto(f"{address}/my")
        page.fill("input[name=token]", api.tokens["alpha"])
        page.click("main form button")
        page.wait_for_url("**/my")
        page.evaluate("window.isStillTheSamePage = true")
        return page

    yield open_page
    for context in contexts:
        context.close()


@pytest.mark.parametrize("blocked", [False, True], ids=["events", "events blocked"])
def test_the_list_shows_place_and_quota_and_follows_to_the_end(
    api: "Api", my_page: Callable[..., Page], address: str, blocked: bool
) -> None:
    first, second = (api.submit(content).json()["id"] for content in ("one", "two"))
    page = my_page(blocked=blocked)
    rows = page.locator(".runs tbody tr")
    expect(rows).to_have_count(2)
    expect(rows.nth(0)).to_contain_text("1 submission ahead")
    expect(rows.nth(1)).to_contain_text("next in line")
    expect(page.locator(".quotas")).to_contain_text("3 of 5")
    expect(page.locator(".quotas time")).to_have_attribute(
        "datetime", api.get("/phases/dev", "alpha").json()["quota"]["resets_at"]
    )
    own = page.context.new_page()
    if blocked:
        own.route("**/events", lambda route: route.abort())
    own.goto(f"{address}/submissions/{first}")
    region = own.locator("main > p[role=status]")
    expect(region).to_have_text("")
    region.evaluate("(region) => { region.isStillThere = true; }")
    api.score(first)
    expect(own).to_have_title(re.compile(", scored: "), timeout=LONGEST_MS)
    expect(region).to_have_text(re.compile("^scored Every sample has been scored"))
    assert region.evaluate("(region) => region.isStillThere"), (
        "one that is replaced is not read out"
    )
    assert own.locator("#live [role=status]").count() == 0
    expect(rows.nth(1).locator(".badge")).to_have_text("scored", timeout=LONGEST_MS)
    expect(rows.nth(0)).to_contain_text("next in line", timeout=LONGEST_MS)
    for label in rows.nth(0).locator("td.none").all():
        box = label.bounding_box()
        assert box is not None, "a cell that is not there shifts the headers of those behind it"
        assert box["width"] <= 1
    assert rows.nth(0).locator("td.none").count()
    api.score(second)
    expect(rows.nth(0).locator(".badge")).to_have_text("scored", timeout=LONGEST_MS)
    assert page.evaluate("window.isStillTheSamePage"), "it was followed without a reload"


def test_a_new_token_is_copied_by_a_button_that_can_be_seen(
    my_page: Callable[..., Page], address: str
) -> None:
    page = my_page()
    page.context.grant_permissions(["clipboard-read", "clipboard-write"], origin=address)
    page.goto(f"{address}/my/tokens")
    page.fill("input[name=name]", "cluster")
    page.click("button:text-is('Issue the token')")
    token = page.get_attribute(".issued pre", "data-copy")
    assert token is not None
    assert token in page.inner_text(".issued pre")
    page.click(".issued button:text-is('Copy')")
    expect(page.locator(".issued button")).to_have_text("Copied")
    assert page.evaluate("navigator.clipboard.readText()") == token


@pytest.mark.parametrize(
    ("page_of_form", "button"),
    [
        ("/my/tokens", "Issue the token"),
        ("/my/tokens", "Rotate"),
        ("/my/notices", "Add"),
    ],
)
def test_what_is_shown_once_is_made_once_however_often_its_page_is_loaded(
    api: "Api", my_page: Callable[..., Page], address: str, page_of_form: str, button: str
) -> None:
    page = my_page()
    page.goto(f"{address}{page_of_form}")
    for field, text in (("name", "cluster"), ("address", "https://example.org/hook")):
        if page.locator(f"input[name={field}]").count():
            page.fill(f"input[name={field}]", text)
    page.locator(f"button:has-text('{button}')").first.click()
    expect(page.locator(".issued pre")).to_be_visible()
    with api.database.read() as session:
        n_lines = session.scalar(select(func.count()).select_from(AuditLine))
    for _ in range(2):
        answer = page.reload()
        assert answer is not None
        assert (answer.request.method, answer.status) == ("GET", 200)
        assert page.url == f"{address}{page_of_form}"
        expect(page.locator(".issued")).to_have_count(0)
    with api.database.read() as session:
        assert session.scalar(select(func.count()).select_from(AuditLine)) == n_lines


def test_a_refused_upload_is_said_in_red_below_an_empty_bar_and_stays_in_its_form(
    api: "Api", my_page: Callable[..., Page], address: str
) -> None:
    api.submit("one", method="M" * 80)
    page = my_page()
    page.goto(f"{address}/submit")
    page.set_input_files(
        "input[name=file]", {"name": "one.json", "mimeType": "application/json", "buffer": b"one"}
    )
    page.fill("input[name=method]", "Other")
    page.click("form[data-upload] button:text-is('Submit')")
    expect(page.locator("form[data-upload] button:text-is('Submit')")).to_be_focused()
    words = page.locator(".sending [role=status]")
    expect(words).to_contain_text("a run of 'MMM")
    expect(words).to_have_css("color", page.evaluate(_INK_OF_HARM))
    assert page.evaluate("document.querySelector('progress').value") == 0
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    assert page.input_value("input[name=method]") == "Other"


def test_only_a_run_of_the_chosen_phase_can_be_linked(
    api: "Api", my_page: Callable[..., Page], address: str
) -> None:
    api.phase("words", challenge="strategy")
    plain = api.submit("one", phase="words").json()["id"]
    api.score(plain)
    page = my_page()
    page.goto(f"{address}/submit?phase=words")
    link = page.locator("select[name=linked_to]")
    link.select_option(plain)
    page.check("input[name=phase][value=dev]")
    expect(link).to_be_disabled()
    expect(link).to_have_value("")
    page.check("input[name=phase][value=words]")
    expect(link).to_be_enabled()
    link.select_option(plain)


def test_a_wrong_fact_of_a_method_is_told_and_its_section_stays_open(
    my_page: Callable[..., Page], address: str
) -> None:
    page = my_page()
    page.goto(f"{address}/submit")
    page.set_input_files(
        "input[name=file]", {"name": "one.json", "mimeType": "application/json", "buffer": b"one"}
    )
    page.locator("form.upload summary").click()
    wrong = page.locator("details input[type=number]").first
    wrong.fill("-5")
    page.fill("input[name=method]", "Kestrel")
    page.click("form[data-upload] button:text-is('Submit')")
    expect(wrong).to_be_focused()
    expect(wrong).to_be_visible()


def test_a_form_that_is_refused_without_script_takes_the_keyboard_to_the_reason(
    browser: Browser, api: "Api", address: str
) -> None:
    with browser.new_context(java_script_enabled=False) as context:
        page = context.new_page()
        page.goto(f"{address}/sign-in?back=/my/notices")
        page.fill("input[name=token]", "no token")
        page.keyboard.press("Enter")
        expect(page.locator("input[aria-invalid=true]")).to_be_focused()
        page.fill("input[name=token]", api.tokens["alpha"])
        page.click("main form button")
        page.fill("input[name=address]", "http://no-https")
        page.keyboard.press("Enter")
        expect(page.locator("#refusal")).to_be_focused()


def test_a_choice_of_organizers_waits_for_its_button(
    browser: Browser, api: "Api", address: str
) -> None:
    """By arrow keys each choice on the way to another one is made, too."""
    with browser.new_context() as context:
        page = context.new_page()
        page.goto(f"{address}/sign-in?back=/organize/submissions")
        page.fill("input[name=token]", api.tokens["organizer"])
        page.click("main form button")
        page.wait_for_url("**/organize/submissions")
        status = page.locator("select[name=status]")
        words = status.locator("option").all_inner_texts()
        status.focus()
        for word in words[1:3]:
            page.keyboard.press("ArrowDown")
            expect(status).to_have_value(word)
            expect(status).to_be_focused()
        page.click("button:text-is('Show')")
        page.wait_for_url(f"**status={words[2]}")


def test_the_menu_of_a_phone_closes_behind_the_focus(
    my_page: Callable[..., Page], address: str
) -> None:
    page = my_page()
    page.click(".menu summary")
    links = page.locator(".menu nav a")
    links.last.focus()
    expect(links.last).to_be_visible()
    page.keyboard.press("Tab")
    expect(links.last).to_be_hidden()


@pytest.mark.parametrize("width", [900, 1024])
def test_the_head_of_an_organizers_page_stays_within_its_width_and_level(
    browser: Browser, api: "Api", address: str, width: int
) -> None:
    """Nobody has more links in it."""
    with browser.new_context(viewport={"width": width, "height": 844}) as context:
        page = context.new_page()
        page.goto(f"{address}/sign-in")
        page.fill("input[name=token]", api.tokens["organizer"])
        page.click("main form button")
        page.wait_for_url("**/organize")
        middles = """links => new Set(links.map((link) => link.getBoundingClientRect()).map(
            (box) => Math.round(box.top + box.bottom))).size"""
        assert page.locator("header .nav a").evaluate_all(middles) == 1
        assert page.evaluate("document.documentElement.scrollWidth") <= width


def test_on_a_narrow_phone_the_form_of_an_upload_stays_in_its_card(
    my_page: Callable[..., Page], address: str
) -> None:
    page = my_page()
    page.set_viewport_size({"width": 320, "height": 844})
    page.goto(f"{address}/submit")
    page.locator("form.upload summary").click()
    reaches = """form => Math.max(...[...form.querySelectorAll("*")].map(
        (part) => part.getBoundingClientRect().right)) - form.getBoundingClientRect().right"""
    assert page.locator("form.upload").evaluate(reaches) <= 0


def test_a_question_of_one_long_word_stays_within_the_page(
    my_page: Callable[..., Page], address: str
) -> None:
    page = my_page()
    page.goto(f"{address}/my/questions/dev")
    page.fill("textarea[name=text]", "x" * 500)
    page.click("button:text-is('Ask')")
    expect(page.locator("article")).to_contain_text("x" * 500)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390


@pytest.mark.parametrize(
    "path", ["/organize/messages", "/organize", "/organize/phases/long", "/?phase=long"]
)
def test_one_long_word_for_a_name_keeps_pages_within_their_width(
    api: "Api", browser: Browser, address: str, path: str
) -> None:
    team = {"id": "long", "name": "W" * 80}
    assert api.post("/organizer/teams", "organizer", json=team).status_code == 201
    api.phase("long", title="X" * 120, shows_reported=True)
    with browser.new_context(viewport={"width": 390, "height": 844}) as context:
        page = context.new_page()
        page.goto(f"{address}/sign-in?back={path}")
        page.fill("input[name=token]", api.tokens["organizer"])
        page.click("main form button")
        page.wait_for_url(f"**{path}")
        assert page.get_by_text(re.compile("W{80}|X{120}")).count()
        assert page.evaluate("document.documentElement.scrollWidth") <= 390


def test_no_request_names_the_page_that_it_comes_from(
    browser: Browser, api: "Api", address: str
) -> None:
    """The proxy writes beside an error what a browser names, and some addresses hold a secret."""
    with browser.new_context() as context:
        page = context.new_page()
        named: dict[str, str] = {}
        page.on(
            "request",
            lambda request: named.update({request.url: request.headers.get("referer", "")}),
        )
        page.goto(f"{address}/sign-in?back=/join/b.hush")
        page.fill("input[name=token]", api.tokens["alpha"])
        page.click("main form button")
        page.wait_for_url("**/join/b.hush")
        page.click("header .brand")
        page.wait_for_url(f"{address}/")
    assert f"{address}/" in named.values(), "nothing was noted"
    assert "hush" not in str(named.values())


def test_of_a_form_older_than_the_session_the_browser_still_holds_what_was_typed(
    api: "Api", my_page: Callable[..., Page], address: str
) -> None:
    page = my_page()
    page.goto(f"{address}/my/questions/dev")
    page.fill("textarea[name=text]", "May a planner use maps?")
    page.context.clear_cookies()
    again = page.context.new_page()
    again.goto(f"{address}/sign-in")
    again.fill("input[name=token]", api.tokens["alpha"])
    again.click("main form button")
    again.wait_for_url("**/my")
    page.click("button:text-is('Ask')")
    expect(page.locator("main")).to_contain_text(
        "go back and send it again: your browser may still hold what you typed"
    )
    page.go_back()
    page.click("button:text-is('Ask')")
    expect(page.locator("article")).to_contain_text("May a planner use maps?")


def test_a_double_click_issues_one_token(my_page: Callable[..., Page], address: str) -> None:
    page = my_page()
    page.goto(f"{address}/my/tokens")
    n_before = page.locator("tbody tr").count()
    page.fill("input[name=name]", "cluster")
    page.evaluate(
        "() => { const b = document.querySelector('.upload button'); b.click(); setTimeout(() => b.click(), 30); }"
    )
    page.wait_for_selector(".issued pre")
    page.goto(f"{address}/my/tokens")
    assert page.locator("tbody tr").count() == n_before + 1


def test_on_paper_the_list_is_a_table_without_filters_and_buttons(
    browser: Browser, api: "Api", address: str
) -> None:
    api.submit("one")
    with browser.new_context(viewport={"width": 720, "height": 844}) as context:
        page = context.new_page()
        page.goto(f"{address}/sign-in?back=/organize/submissions")
        page.fill("input[name=token]", api.tokens["organizer"])
        page.click("main form button")
        page.wait_for_url("**/organize/submissions")
        for path in ("/organize/submissions", "/organize/audit"):
            page.goto(address + path)
            page.emulate_media(media="print")
            assert page.locator(":is(.ofilt, .btn, .onav):visible").count() == 0
            heads = page.locator("thead th")
            expect(heads.first).to_be_visible()
            assert heads.first.evaluate("(head) => head.offsetWidth") > 30
            assert page.evaluate("document.documentElement.scrollWidth") <= 720
