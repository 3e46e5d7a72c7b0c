"""The pages in a real browser: without script, by keyboard, narrow, dark, and looked at by axe."""

import re
from collections.abc import Iterator
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, Route, ViewportSize, expect
from tests.server.pages.page_site import Site
from tests.support.browser import Look, axe_violations, look_at

from exceptiondrive_schemas.board import Board
from exceptiondrive_server.boards.charts import _text_box

pytestmark = pytest.mark.browser
PATHS = (
    "/",
    "/?average=micro&sort=ur",
    "/?phase=paper",
    "/?phase=strategy",
    "/compare?phase=strategy",
    "/?phase=empty",
    "/?phase=unpublished",
    "/entries/s0000000kq",
    "/entries/s0000005kq",
    "/entries/s0000000kq/samples/worst-bypass_and_gap_conflict",
    "/entries/s0000000kq/samples/middle-road_surface_hazard",
    "/entries/a0000000kq?phase=strategy",
    "/entries/reference-freeze?phase=sample",
    "/reported/planning",
    "/reported/strategy",
    "/entries/l0000000kq",
    "/compare",
    "/protocols/1.0",
    "/splits/sample",
    "/submit",
    "/problems",
    "/problems/file_invalid",
    "/problems/wrong_waypoint_count",
    "/api",
    "/privacy",
)


class Visit:
    """A browser before a running site; notes every request that leaves it and every complaint."""

    def __init__(self, browser: Browser, address: str) -> None:
        self.browser = browser
        self.address = address
        self.foreign: list[str] = []
        self.complaints: list[str] = []

    def open(self, path: str, width: int = 1360, **context: Any) -> Page:
        viewport = ViewportSize(width=width, height=900)
        page = self.browser.new_context(viewport=viewport, **context).new_page()
        page.on("console", lambda message: self.complaints.append(message.text))
        page.on("pageerror", lambda error: self.complaints.append(str(error)))
        page.on("request", lambda request: self._note(request.url))
        page.goto(self.address + path)
        return page

    def _note(self, url: str) -> None:
        if not url.startswith((self.address, "data:")):
            self.foreign.append(url)


@pytest.fixture
def visit(browser: Browser, address: str) -> Iterator[Visit]:
    """A browser before the running site."""
    yield Visit(browser, address)
    for context in browser.contexts:
        context.close()


def first_planner(page: Page) -> str:
    return page.locator("#board-rows tbody th .pn").first.inner_text()


def test_sorting_filtering_and_hiding_columns_work_without_script(visit: Visit) -> None:
    page = visit.open("/", java_script_enabled=False)
    page.click("#board-rows thead a:has-text('UR')")
    page.wait_for_url("**sort=ur**")
    page.click("#board-rows thead a:has-text('UR')")
    page.wait_for_url("**sort=-ur**")
    assert first_planner(page) == "nerve"
    assert page.get_attribute("#board-rows thead th[aria-sort]", "aria-sort") == "descending"
    page.fill("input[name=q]", "osprey")
    page.click("form.filters > button")
    assert first_planner(page) == "brake-late"
    assert "q=osprey" in page.url
    page.goto(visit.address)
    page.click("details.more summary")
    page.uncheck("input[name=show][value=cts_x]")
    with page.expect_navigation():
        page.click(".pop button[type=submit]")
    assert "hide=cts_x" in page.url
    assert page.locator("#board-rows th.cts_x, #board-rows td.cts_x").count() == 0


def test_everything_can_be_read_without_script(visit: Visit) -> None:
    page = visit.open("/", java_script_enabled=False)
    for words in (
        "Kestrel-2",
        "61.40",
        "Stands still",
        "see its table",
        "Which hazards are hardest",
    ):
        assert page.get_by_text(words).first.is_visible()


def test_from_an_entry_to_each_of_its_drawings_without_script(visit: Visit) -> None:
    page = visit.open("/entries/s0000000kq", java_script_enabled=False)
    assert page.locator(".sheet svg.draw").count() == 12
    with page.expect_navigation():  # counted is on a whole page
        page.click(".sheet li a >> nth=0")
    seen = {page.inner_text("h1")}
    while page.locator("a[rel=next]").count():
        with page.expect_navigation():
            page.click("a[rel=next]")
        seen.add(page.url)
    assert len(seen) == 12
    page.click(".crumbs a")
    assert page.url.endswith("/entries/s0000000kq#hd")


@pytest.mark.parametrize(("width", "shown"), [(1360, "wide"), (390, "nar")])
def test_a_drawing_fits_its_screen_and_follows_the_theme(
    visit: Visit, width: int, shown: str
) -> None:
    fills = set()
    for scheme in ("light", "dark"):
        path = "/entries/s0000000kq/samples/worst-bypass_and_gap_conflict"
        page = visit.open(path, width=width, color_scheme=scheme)
        drawings = page.locator(".onesample > .draw:visible")
        assert drawings.count() == 1
        assert shown in (drawings.get_attribute("class") or "").split()
        region = drawings.locator(".region")
        fills.add(region.evaluate("(shape) => getComputedStyle(shape).fill"))
    assert len(fills) == 2


def test_the_theme_switch_works_without_script_and_survives_navigation(visit: Visit) -> None:
    page = visit.open("/?sort=ur", java_script_enabled=False, color_scheme="light")
    light = page.evaluate("getComputedStyle(document.body).backgroundColor")
    page.click("form.theme button[value=dark]")
    assert page.url.endswith("/?sort=ur")
    dark = page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert (light, dark) == ("rgb(246, 244, 238)", "rgb(16, 19, 23)")
    page.goto(visit.address + "/submit")
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == dark


def test_with_script_the_theme_changes_in_place_and_is_remembered(visit: Visit) -> None:
    page = visit.open("/", color_scheme="dark")
    page.click("form.theme button[value=light]")
    assert page.get_attribute("html", "data-theme") == "light"
    page.reload()
    assert page.get_attribute("html", "data-theme") == "light"
    assert visit.complaints == []


def test_with_script_all_rows_are_searched_while_typing(visit: Visit) -> None:
    page = visit.open("/?phase=long&rows=20")
    page.locator("input[name=q]").press_sequentially("planner 77")
    expect(page.locator("#board-rows tr[id^='e-']")).to_have_count(1)
    assert first_planner(page) == "Planner 77"
    assert page.inner_text("#found") == "1 planner of 90 found for \u201cplanner 77\u201d."
    assert "q=planner+77" in page.url
    assert page.evaluate("document.activeElement.name") == "q"
    page.locator("input[name=q]").press_sequentially("x")
    page.wait_for_selector("#board-rows .nothing")
    assert "Nothing matches this filter." in page.inner_text("#board-rows")
    assert visit.complaints == []


def test_back_after_a_search_leads_to_the_whole_list(visit: Visit) -> None:
    page = visit.open("/?phase=long&rows=20")
    page.locator("input[name=q]").press_sequentially("planner 7", delay=200)
    expect(page.locator("#found")).to_contain_text("found for \u201cplanner 7\u201d.")
    page.keyboard.press("Enter")
    expect(page.locator("#found")).to_contain_text("found for \u201cplanner 7\u201d.")
    page.go_back()
    expect(page.locator("#found")).to_be_empty()
    expect(page.locator("#board-rows tr[id^='e-']")).to_have_count(20)
    assert page.url.endswith("/?phase=long&rows=20")


def test_back_leads_to_the_whole_list_where_answers_come_after_more_was_typed(visit: Visit) -> None:
    page = visit.open("/?phase=long&rows=20")
    held: list[Route] = []
    page.route("**/?**q=p&**", lambda route: held.append(route))
    with page.expect_request("**/?**q=p&**"):
        page.locator("input[name=q]").press_sequentially("p")
    page.locator("input[name=q]").press_sequentially("lanner 7")
    expect(page.locator("#found")).to_contain_text("found for \u201cplanner 7\u201d.")
    held[0].abort()
    page.go_back()
    expect(page.locator("#board-rows tr[id^='e-']")).to_have_count(20)
    assert page.url.endswith("/?phase=long&rows=20")


def test_sorting_by_keyboard_keeps_the_focus_on_its_head(visit: Visit) -> None:
    page = visit.open("/?phase=long")
    for order in ("ascending", "descending"):
        page.focus("#s-ur")
        page.keyboard.press("Enter")
        page.wait_for_selector(f"#board-rows th.ur[aria-sort={order}]")
        assert page.evaluate("document.activeElement.id") == "s-ur"
    assert first_planner(page) == "Planner 89"
    page.go_back()
    page.wait_for_selector("#board-rows th.ur[aria-sort=ascending]")


def test_going_back_by_keyboard_meets_nothing_under_the_head_of_the_table(visit: Visit) -> None:
    page = visit.open("/?phase=long", reduced_motion="reduce")
    rows = page.locator("#board-rows tr[id^='e-']")
    rows.last.locator("a").first.focus()
    met = 0
    while page.evaluate("!!document.activeElement.closest('#board-rows tbody')"):
        page.wait_for_function(
            """() => document.activeElement.getBoundingClientRect().top
                >= document.querySelector("#board-rows th.method").getBoundingClientRect().bottom"""
        )
        page.keyboard.press("Shift+Tab")
        met += 1
    assert met > rows.count()


def test_the_head_of_the_names_stays_above_the_numbers_that_scroll_under_it(visit: Visit) -> None:
    page = visit.open("/", width=640)
    page.evaluate("document.querySelector('.scroll.b').scrollLeft = 999")
    page.locator("#board-rows").scroll_into_view_if_needed()
    link = page.locator("#s-method")
    box = link.bounding_box()
    assert box is not None
    assert page.evaluate("document.querySelector('.scroll.b').scrollLeft") > 0
    assert link.evaluate(
        "(link, [x, y]) => link.contains(document.elementFromPoint(x, y))",
        [box["x"] + box["width"] / 2, box["y"] + box["height"] / 2],
    )


def test_going_back_to_a_head_that_lies_under_the_names_brings_it_out(visit: Visit) -> None:
    page = visit.open("/", width=640, reduced_motion="reduce")
    page.evaluate("document.querySelector('.scroll.b').scrollLeft = 999")
    page.focus("#s-ur")
    for _ in ("what HCC is", "HCC"):
        page.keyboard.press("Shift+Tab")
    link, names = (
        page.locator("#s-hcc").bounding_box(),
        page.locator(".method").first.bounding_box(),
    )
    assert link is not None
    assert names is not None
    assert page.evaluate("document.activeElement.id") == "s-hcc"
    assert link["x"] >= names["x"] + names["width"]


def test_a_search_keeps_the_order_and_the_head_of_the_ranks_leads_back_to_theirs(
    visit: Visit,
) -> None:
    page = visit.open("/?phase=long")
    page.click("#s-ur")
    page.wait_for_selector("#board-rows th.ur[aria-sort=ascending]")
    page.locator("input[name=q]").press_sequentially("planner 77")
    expect(page.locator("#board-rows tr[id^='e-']")).to_have_count(1)
    assert page.url.endswith("/?phase=long&q=planner+77&sort=ur")
    page.click("#s-rank")
    page.wait_for_selector("#board-rows th.hcc[aria-sort]")
    assert page.url.endswith("/?phase=long&q=planner+77")
    assert page.input_value("select[name=sort]") == "rank"
    page.go_back()
    page.wait_for_selector("#board-rows th.ur[aria-sort]")


def test_a_link_within_the_board_moves_the_focus_and_loads_nothing(visit: Visit) -> None:
    page = visit.open("/")
    page.evaluate("window.isStillTheSamePage = true")
    page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    expect(page.locator("main")).to_be_focused()
    page.click(".foot a[href='#about']")
    page.go_back()
    page.go_back()
    assert page.url == f"{visit.address}/"
    assert page.evaluate("window.isStillTheSamePage")


def test_a_page_left_open_shows_all_of_a_newer_board_once_its_rows_are_asked_for(
    visit: Visit, shown_site: Site, lively_board: Board
) -> None:
    board = lively_board.model_copy(update={"phase": "moving", "entries": ()})
    shown_site.create_phase("moving", visibility="archived")
    shown_site.publish(board)
    page = visit.open("/?phase=moving")
    assert page.inner_text(".ft p").startswith("Board 1,")
    shown_site.publish(board.model_copy(update={"entries": lively_board.entries}))
    page.click("#s-ur")
    expect(page.locator(".ft p")).to_contain_text("Board 2,")
    assert page.locator("#about dd:has-text('No. 2')").count() == 1
    assert page.get_attribute("#board-rows thead th[aria-sort]", "class") == "pm ur"
    page.go_back()
    expect(page.locator("#board-rows th.hcc[aria-sort]")).to_be_visible()


def test_on_a_phone_the_list_can_be_sorted_without_script(visit: Visit) -> None:
    page = visit.open("/?phase=long", width=390, java_script_enabled=False)
    page.select_option("select[name=sort]", "-ur")
    page.press("input[name=q]", "Enter")
    assert "sort=-ur" in page.url
    assert first_planner(page) == "Planner 89"


def test_ticked_rows_of_several_pages_are_compared(visit: Visit) -> None:
    page = visit.open("/?phase=long")
    assert not page.locator("#chosen").is_visible()
    page.check("#e-s0000003kq .tick")
    page.click(".pager a:text-is('5')")
    page.wait_for_selector("#e-s0000085kq")
    page.check("#e-s0000085kq .tick")
    page.check("#e-s0000087kq .tick")
    assert page.inner_text("#chosen .n") == "3 chosen"
    page.click("#chosen .pri")
    assert page.inner_text("h1") == "3 planners side by side"
    assert {"Planner 3", "Planner 85", "Planner 87"} <= set(
        page.locator("#all th a").all_inner_texts()
    )


def test_without_script_ticked_rows_are_counted_and_compared(visit: Visit) -> None:
    page = visit.open("/?phase=long", java_script_enabled=False)
    for key in ("s0000001kq", "s0000004kq"):
        page.check(f"#e-{key} .tick")
    assert page.locator("#chosen").is_visible()
    page.click("#chosen .pri")
    assert page.inner_text("h1") == "Planner 1 against Planner 4"


def test_a_pinned_planner_stands_on_top_of_every_page(visit: Visit) -> None:
    page = visit.open("/?phase=long")
    page.hover("#e-s0000007kq")
    page.click("#e-s0000007kq .pin")
    page.wait_for_selector(".pinned #e-s0000007kq")
    page.goto(f"{visit.address}/?phase=long&page=3")
    page.wait_for_selector(".pinned #e-s0000007kq")
    assert first_planner(page) == "Planner 7"
    page.click(".pinned .pin")
    expect(page.locator(".pinned")).to_have_count(0)
    assert visit.complaints == []


def test_rows_can_be_dense_and_stay_so(visit: Visit) -> None:
    page = visit.open("/?phase=long")
    row = "document.querySelector('#board-rows tr[id]').getBoundingClientRect().height"
    assert page.evaluate(row) == 44
    page.click(".bar summary:text-is('View')")
    page.click(".density button[value=dense]")
    assert page.evaluate(row) == 34
    page.reload()
    assert page.evaluate(row) == 34


FIRST_SCREEN = """() => {
  const rows = [...document.querySelectorAll("#board-rows tr[id^='e-']")].filter((row) => {
    const number = row.querySelector(".pm small");
    return number?.checkVisibility() && row.getBoundingClientRect().bottom <= LIMIT;
  });
  return {rows: rows.length, said: rows.map((row) => row.querySelector(".pm").innerText.trim()),
    hero: document.querySelector(".hero").getBoundingClientRect().height,
    heights: [...new Set([...document.querySelectorAll("#board-rows tr[id^='e-']")]
      .map((row) => row.getBoundingClientRect().height))]};
}"""


@pytest.mark.parametrize("phase", ["sample", "long"])
@pytest.mark.parametrize(
    ("width", "height", "limit", "least", "row"), [(1440, 900, 900, 5, 44), (390, 844, 700, 2, 64)]
)
def test_the_first_screen_shows_ranked_planners_and_how_sure_they_are(
    visit: Visit, phase: str, width: int, height: int, limit: int, least: int, row: int
) -> None:
    page = visit.open(f"/?phase={phase}", width=width)
    page.set_viewport_size({"width": width, "height": height})
    seen = page.evaluate(FIRST_SCREEN.replace("LIMIT", str(limit)))
    assert seen["rows"] >= least
    assert all(re.search(r"\d\.\d\s*[\u00b1\u2212+]\d", said) for said in seen["said"])
    assert seen["heights"] == [row]
    if width > 1000:
        assert seen["hero"] <= 240


UNBROKEN = """() => {
  const walker = document.createTreeWalker(document.querySelector("main"), NodeFilter.SHOW_TEXT);
  const name = "NameWithoutASpaceThatFills" + "EightyCharacters".repeat(3);
  while (walker.nextNode()) {
    const node = walker.currentNode;
    if (!node.parentElement.closest("svg, details")) node.data = node.data.replaceAll(NAME, name);
  }
  const root = document.documentElement;
  const aside = [...document.querySelectorAll(PARTS)].filter(
    (part) => part.scrollWidth > part.clientWidth + 1);
  return {named: root.innerText.includes(name), page: root.scrollWidth - root.clientWidth,
    aside: aside.map((part) => part.outerHTML.slice(0, 80))};
}"""


@pytest.mark.parametrize("width", [390, 1440])
@pytest.mark.parametrize(
    ("path", "parts"),
    [
        ("/compare", ".two .scroll"),
        ("/", ".two .scroll, .sub"),
        ("/history?phase=sample", ".hist p"),
    ],
)
def test_a_name_without_spaces_breaks_and_moves_no_column_out_of_sight(
    visit: Visit, path: str, parts: str, width: int
) -> None:
    page = visit.open(path, width=width)
    leader = visit.open("/").locator("#board-rows .pn").first.inner_text()
    seen = page.evaluate(UNBROKEN.replace("NAME", repr(leader)).replace("PARTS", repr(parts)))
    assert seen == {"named": True, "page": 0, "aside": []}


RIGHT_TO_LEFT = """() => {
  const line = document.querySelector("main").appendChild(document.createElement("p"));
  line.innerHTML = "<b>\u05de\u05ea\u05db\u05e0\u05df (2)</b> <span>\u05e6\u05d5\u05d5\u05ea (3)</span> came";
  return [...line.children].map((part) => part.getBoundingClientRect().left);
}"""


def test_names_from_right_to_left_stay_in_the_order_of_the_sentence(visit: Visit) -> None:
    name, team = visit.open("/history?phase=sample").evaluate(RIGHT_TO_LEFT)
    assert name < team


@pytest.mark.parametrize("width", [1440, 1100, 360])
def test_what_a_row_of_one_s_own_would_say_is_not_cut(visit: Visit, width: int) -> None:
    page = visit.open("/", width=width)
    words = page.locator(".you .tm")
    words.evaluate(
        "(part) => { part.textContent = 'on the board once the organizers reveal the board'; }"
    )
    assert words.evaluate("(part) => part.scrollWidth <= part.clientWidth")
    command = page.locator(".you .cmd")
    command.evaluate(
        "(part) => part.firstElementChild.append(' --method \"A longer name\"'.repeat(3))"
    )
    assert command.evaluate("(part) => part.scrollWidth <= part.clientWidth")


@pytest.mark.parametrize("path", ["/problems", "/problems/file_invalid"])
def test_a_code_breaks_at_its_underscores_alone(visit: Visit, path: str) -> None:
    page = visit.open(path, width=320)
    found = page.locator(".codes th code").evaluate_all(
        "codes => codes.flatMap((code) => [...code.childNodes].filter((part) => part.data))"
        ".map((part) => { const range = document.createRange(); range.selectNode(part);"
        " return [part.data, range.getClientRects().length]; })"
    )
    assert ["waypoint_", 1] in found
    assert [part for part, lines in found if lines > 1] == []


@pytest.mark.parametrize("width", [320, 390])
def test_no_head_of_a_comparison_breaks_within_its_word(visit: Visit, width: int) -> None:
    page = visit.open("/compare?phase=pairs&a=s0000000kq&b=s0000002kq", width=width)
    heads = page.locator("#paired thead th").filter(has_text="Difference")
    assert heads.count() > 0
    heights = heads.evaluate_all(
        "heads => heads.map((head) => { const range = document.createRange();"
        " range.selectNodeContents(head); return range.getClientRects().length; })"
    )
    assert set(heights) == {1}


def test_the_words_of_a_legend_stay_clear_of_the_next_mark(visit: Visit) -> None:
    page = visit.open("/?phase=strategy", width=1440)
    word = page.locator("svg text.ans-w:text-is('acceptable')").bounding_box()
    question = page.locator("svg text.ans-q").bounding_box()
    marks = [mark.bounding_box() for mark in page.locator("svg .ans:not(:has(text)) circle").all()]
    assert word is not None
    assert question is not None
    (first, second) = (mark["x"] for mark in marks if mark is not None)
    assert question["x"] + question["width"] + 4 < first < word["x"]
    assert word["x"] + word["width"] + 4 < second


def test_the_words_of_an_empty_card_stay_clear_of_its_edge_on_a_phone(visit: Visit) -> None:
    page = visit.open("/status", width=390)
    edges = """() => {
      const card = document.querySelector("main").appendChild(document.createElement("div"));
      card.className = "card nothing-yet";
      card.innerHTML = "<p>" + "People sign in here with a token of the team. ".repeat(4) + "</p>";
      return [card, card.firstChild].map((part) => part.getBoundingClientRect().left);
    }"""
    card, words = page.evaluate(edges)
    assert words - card >= 16


def test_in_forced_colours_a_scale_keeps_its_colours(visit: Visit) -> None:
    page = visit.open("/", forced_colors="active")
    fills = "parts => parts.map((part) => getComputedStyle(part).backgroundColor)"
    assert len(set(page.locator(".ramp b").evaluate_all(fills))) == 10
    assert len(set(page.locator(".sw").evaluate_all(fills))) == 2
    assert len(set(page.locator(".heat td > span").evaluate_all(fills))) > 3


def test_in_forced_colours_marks_of_the_board_are_lines(visit: Visit) -> None:
    page = visit.open("/", forced_colors="active")
    first = page.locator("#board-rows .first > :first-child").first
    assert first.evaluate("it => getComputedStyle(it).borderLeftWidth") == "4px"
    best = page.locator("#board-rows .best").first
    assert best.evaluate("it => getComputedStyle(it).outlineStyle") == "solid"


def test_the_best_number_is_told_in_words_too(visit: Visit) -> None:
    page = visit.open("/")
    assert page.locator("#board-rows td.hcc:has(.best)").text_content() == "61.4\u00b14.1, best"
    sentence = "Highlighted: the best value in its column that may lead."
    assert sentence in page.inner_text(".foot")
    page.goto(f"{visit.address}/?source=reference")
    assert sentence not in page.inner_text(".foot")


def test_a_count_is_a_word_of_its_own_and_can_be_read(visit: Visit) -> None:
    page = visit.open("/", bypass_csp=True)
    assert page.get_by_role("link", name="All 9", exact=True).count() == 1
    chips = '<p class="chips"><a class="chip" href="/">VLA <i>19</i></a></p>'
    page.locator(".filters").evaluate(
        "(form, chips) => form.insertAdjacentHTML('beforeend', chips)", chips
    )
    for scheme in ("light", "dark"):
        look_at(page, (1360, scheme))
        assert [one["id"] for one in axe_violations(page)] == []


@pytest.mark.parametrize("path", ["/", "/entries/s0000000kq", "/compare?a=s0000000kq&b=s0000003kq"])
def test_what_is_in_the_hazard_is_hatched_in_bars_and_legend(visit: Visit, path: str) -> None:
    page = visit.open(path)
    for kind, pattern in (("hit", "#hit"), ("unmoved", "#unmoved")):
        fills = page.locator(f".b-{kind}").evaluate_all(
            "parts => parts.map((part) => getComputedStyle(part).fill)"
        )
        assert len(fills) > 1
        assert set(fills) == {f'url("{pattern}")'}
        ground, lines = (
            page.locator(f"pattern{pattern} > {part}").evaluate("it => getComputedStyle(it).fill")
            for part in ("rect", "path")
        )
        assert ground != lines


def test_the_curves_of_a_page_stand_in_a_table_too(visit: Visit) -> None:
    page = visit.open("/entries/l0000000kq", java_script_enabled=False)
    page.click("summary:text-is('Show this chart as a table')")
    table = page.get_by_role("region", name="Table: distance kept")
    assert table.locator("th").all_inner_texts() == [
        "Kept",
        "0",
        "0.5",
        "1",
        "1.5",
        "2",
        "Kestrel-2",
    ]
    assert table.locator("td").all_inner_texts() == ["90.00", "67.50", "45.00", "22.50", "0.00"]


def test_a_title_of_a_phase_without_spaces_breaks(visit: Visit) -> None:
    page = visit.open("/compare?phase=sample", width=390)
    title = page.locator(".eyebrow span").first.text_content()
    long = repr("NameWithoutASpaceThatFills" * 5)
    asked = UNBROKEN.replace("const name = ", f"const name = {long} || ")
    seen = page.evaluate(asked.replace("NAME", repr(title)).replace("PARTS", repr(".eyebrow")))
    assert seen == {"named": True, "page": 0, "aside": []}


LABELS = """() => [...document.querySelectorAll("text.t-lb")].filter((text) => text.checkVisibility())
  .map((text) => [text.textContent, text.getBBox().width])"""


def test_names_in_a_chart_are_no_wider_than_the_room_that_is_kept_for_them(visit: Visit) -> None:
    drawn = visit.open("/").evaluate(LABELS)
    assert len(drawn) > 3
    for text, width in drawn:
        room = _text_box(text, 0, 0, "start")
        assert width <= room.right - room.left + 3, text


def test_names_and_flags_of_a_phone_are_large_enough_for_a_finger(visit: Visit) -> None:
    page = visit.open("/", width=390)
    targets = page.locator("#board-rows .nm:has(.flag:not(.why)) > :is(.pn, .flag)")
    boxes = targets.evaluate_all(
        "all => all.map((one) => one.getBoundingClientRect())"
        ".map((box) => [box.top, box.bottom, box.height, box.width])"
    )
    assert len(boxes) > 2
    assert min(min(height, width) for _, _, height, width in boxes) >= 24
    for (_, end, *_), (start, *_) in zip(boxes[::2], boxes[1::2], strict=True):
        assert end <= start, "no name lies under its flag"


def test_a_tap_on_a_phone_opens_the_rest_of_a_row(visit: Visit) -> None:
    page = visit.open("/?phase=long", width=390, has_touch=True)
    row = page.locator("#e-s0000000kq")
    assert not row.locator("td.ur").is_visible()
    box = row.bounding_box()
    assert box is not None
    page.touchscreen.tap(box["x"] + 250, box["y"] + 40)
    assert row.locator("td.ur").is_visible()
    assert row.locator("td.split").is_visible()
    page.set_viewport_size({"width": 320, "height": 640})
    for number in row.locator("td:is(.pm, .dg)").all():
        assert number.evaluate("cell => cell.scrollWidth <= cell.clientWidth"), number.inner_text()


@pytest.mark.parametrize("part", [".pm b", ".tm", ".wk", "chevron"])
def test_a_tap_anywhere_but_on_a_link_opens_a_row_of_a_phone(visit: Visit, part: str) -> None:
    page = visit.open("/", width=390, has_touch=True, is_mobile=True)
    row = page.locator("#board-rows tr[id]:has(.tm):has(.wk)").first
    row.scroll_into_view_if_needed()
    target = row if part == "chevron" else row.locator(part).first
    box = target.bounding_box()
    assert box is not None
    across = box["width"] - 16 if part == "chevron" else box["width"] / 2
    page.touchscreen.tap(box["x"] + across, box["y"] + box["height"] / 2)
    expect(row.locator(".xp")).to_be_checked()
    expect(row.locator(".split")).to_be_visible()


@pytest.mark.parametrize(
    ("path", "leading", "others"),
    [
        ("/", "HCC %", ["UR %", "HPR %", "CTS m", "CTSx m", "CTSy m"]),
        ("/?sort=ur", "UR %", ["HCC %", "HPR %", "CTS m", "CTSx m", "CTSy m"]),
        ("/?sort=-date", "HCC %", ["UR %", "HPR %", "CTS m", "CTSx m", "CTSy m"]),
        (
            "/?phase=strategy&sort=-missing",
            "Missing %",
            ["Accuracy %", "Under-warning %", "Over-warning %"],
        ),
    ],
)
def test_every_number_of_a_phone_has_its_name_and_the_one_that_sorts_leads(
    visit: Visit, path: str, leading: str, others: list[str]
) -> None:
    page = visit.open(path, width=390)
    row = page.locator("#board-rows tr[id]").first
    names = """cells => cells.filter((cell) => cell.checkVisibility())
      .map((cell) => JSON.parse(getComputedStyle(cell, "::before").content))"""
    assert row.locator("td[data-k]").evaluate_all(names) == [leading]
    row.locator(".xp").press("Space")
    assert sorted(row.locator("td[data-k]").evaluate_all(names)) == sorted([leading, *others])
    if row.locator(".wk").is_visible():
        assert inside(row.locator(".wk").bounding_box(), row.locator("td.by").bounding_box())
    assert page.get_by_role("columnheader").filter(has_text=leading[:3]).count()


def inside(inner: Any, outer: Any) -> bool:
    """Whether a box lies in another one."""
    ends = [(box["y"], box["y"] + box["height"]) for box in (inner, outer)]
    return bool(ends[1][0] <= ends[0][0] and ends[0][1] <= ends[1][1] + 0.5)


def test_the_heads_of_a_phone_are_seen_once_the_keyboard_is_on_them(visit: Visit) -> None:
    page = visit.open("/", width=390)
    head = page.locator("#board-rows thead")
    assert head.evaluate("it => it.getBoundingClientRect().width") <= 1
    page.focus("#s-ur")
    assert head.evaluate("it => it.getBoundingClientRect().width") > 300
    assert page.evaluate("document.documentElement.scrollWidth") <= 390


def test_a_flag_says_why_in_a_pop_over_without_script(visit: Visit) -> None:
    page = visit.open("/", java_script_enabled=False)
    row = page.locator("tr:has(.pn:text-is('nerve'))")
    assert not row.locator(".tip").is_visible()
    row.locator(".flag").click()
    assert "Blind to the edit" in row.locator(".tip").inner_text()
    page.keyboard.press("Escape")
    assert not row.locator(".tip").is_visible()


@pytest.mark.parametrize("width", [1440, 900])
def test_head_and_names_stay_in_sight(visit: Visit, width: int) -> None:
    page = visit.open("/?phase=long&rows=100", width=width)
    page.locator("#e-s0000060kq").scroll_into_view_if_needed()
    page.evaluate("document.querySelector('.scroll.b').scrollLeft = 150")
    head = page.locator("#board-rows thead th.hcc").bounding_box()
    name = page.locator("#e-s0000060kq th").bounding_box()
    row = page.locator("#e-s0000060kq").bounding_box()
    assert head is not None
    assert name is not None
    assert row is not None
    assert 0 <= head["y"] < row["y"]
    assert name["x"] >= page.locator(".scroll.b").bounding_box()["x"]  # type: ignore[index]


def test_rank_and_name_stay_while_a_narrow_window_scrolls_to_the_last_column(visit: Visit) -> None:
    page = visit.open("/?phase=long&rows=20&add=progress", width=640)
    cells = page.locator("#e-s0000000kq > .rank, #e-s0000000kq > th")
    before = [cells.nth(at).bounding_box() for at in range(2)]
    moved = page.evaluate(
        "(document.querySelector('.scroll.b').scrollLeft = 90, "
        "document.querySelector('.scroll.b').scrollLeft)"
    )
    assert moved > 20
    assert [cells.nth(at).bounding_box() for at in range(2)] == before


def test_rows_without_a_rank_are_as_high_as_the_others_on_a_wide_screen(visit: Visit) -> None:
    page = visit.open("/")
    heights = page.eval_on_selector_all(
        "#board-rows tr.listed", "rows => rows.map((row) => row.getBoundingClientRect().height)"
    )
    assert heights
    assert set(heights) == {44}


def test_seventeen_rows_print_on_one_page(visit: Visit) -> None:
    page = visit.open("/?phase=seventeen")
    assert page.locator("#board-rows tr[id^='e-']").count() == 17
    printed = page.pdf(format="A4")
    assert len(re.findall(rb"/Type\s*/Page\b", printed)) == 1


def test_a_print_says_how_much_of_the_board_it_holds_and_can_hold_all_of_it(
    visit: Visit,
) -> None:
    page = visit.open("/?phase=long&rows=20")
    page.emulate_media(media="print")
    assert page.inner_text(".pager") == "Page 1 of 5, 90 entries"
    page.goto(f"{visit.address}/?phase=long&rows=all")
    assert page.locator("#board-rows tr[id^='e-']:visible").count() == 90
    assert page.inner_text(".pager") == "Page 1 of 1, 90 entries"


@pytest.mark.parametrize(
    "path", ["/submit", "/api", "/protocols/1.0", "/entries/s0000000kq", "/compare"]
)
def test_no_navigation_nor_button_is_printed(visit: Visit, path: str) -> None:
    page = visit.open(path)
    page.emulate_media(media="print")
    assert page.locator(":is(.top, .ft nav, .cta, .btn):visible").count() == 0


def test_no_page_scrolls_sideways_at_any_width(visit: Visit) -> None:
    page = visit.open("/")
    for path in PATHS:
        page.goto(visit.address + path)
        for width in (320, 390, 820, 1000, 1360, 1920):
            page.set_viewport_size({"width": width, "height": 900})
            wider = page.evaluate("document.documentElement.scrollWidth - window.innerWidth")
            assert wider <= 0, f"{path} is {wider} px wider than {width} px"


def test_axe_finds_nothing_wrong_nor_in_the_dark_nor_on_a_phone(visit: Visit) -> None:
    sample = "/entries/s0000000kq/samples/worst-bypass_and_gap_conflict"
    in_each_look = ("/", "/entries/s0000000kq", sample, "/protocols/1.0", "/splits/sample")
    assert set(in_each_look) <= set(PATHS)
    page = visit.open("/", bypass_csp=True)
    wide: Look = (1360, "light")
    for path in PATHS:
        look_at(page, wide)
        page.goto(visit.address + path)
        others: tuple[Look, ...] = ((1360, "dark"), (390, "light"))
        for look in (wide, *(others if path in in_each_look else ())):
            look_at(page, look)
            found = [
                f"{one['id']}: {one['nodes'][0]['html'][:160]}" for one in axe_violations(page)
            ]
            assert found == [], (path, look)


def test_nothing_is_fetched_from_elsewhere_and_the_console_stays_silent(visit: Visit) -> None:
    page = visit.open("/")
    for path in PATHS:
        page.goto(visit.address + path)
    assert visit.foreign == []
    assert visit.complaints == []


def test_the_keyboard_reaches_everything_and_shows_where_it_is(visit: Visit) -> None:
    page = visit.open("/")
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.textContent") == "Skip to the content"
    seen = set()
    for _ in range(60):
        page.keyboard.press("Tab")
        seen.add(page.evaluate("document.activeElement.outerHTML.slice(0, 160)"))
        outline = page.evaluate("getComputedStyle(document.activeElement).outlineStyle")
        assert outline != "none"
    joined = "\n".join(seen)
    for wanted in ('value="dark"', "sort=ur", 'name="q"', "source=scored"):
        assert wanted in joined


@pytest.mark.parametrize("path", ["/", "/?phase=strategy"])
def test_every_number_stands_under_its_head_at_any_width(visit: Visit, path: str) -> None:
    page = visit.open(path)
    for width in (1920, 1360, 1241, 1130, 950, 700):
        page.set_viewport_size({"width": width, "height": 900})
        heads = page.evaluate(RIGHT_EDGES, "#board-rows thead tr:last-child")
        cells = page.evaluate(RIGHT_EDGES, "#board-rows tr[id]")
        assert heads == cells, f"{path} at {width} px"
        if width > 1000:  # below, no line spans the cells
            end, line, word = (page.evaluate(it) for it in (END_OF_HEAD, END_OF_LINE, FIRST_WORD))
            assert abs(end - line) < 1, f"{path} at {width} px"
            assert end <= word, f"{path} at {width} px"
        if width > 1240:  # below, the table scrolls in its own box under its head
            assert page.evaluate(FITS), f"{path} at {width} px"


RIGHT_EDGES = """(rule) => [...document.querySelector(rule).children].filter((cell) => cell.offsetWidth)
  .map((cell) => Math.round(cell.getBoundingClientRect().right))"""
END_OF_HEAD = """document.querySelector("#board-rows thead .wk text:last-child")
  .getBoundingClientRect().right"""
END_OF_LINE = (
    """document.querySelector("#board-rows tbody .wk .w-ax").getBoundingClientRect().right"""
)
FIRST_WORD = """document.querySelector("#board-rows thead .wk").closest("th")
  .querySelector(".s > span:not([class])").getBoundingClientRect().left"""
FITS = """(() => { const box = document.querySelector(".scroll.b");
  return box.scrollWidth <= box.clientWidth; })()"""


def test_phone_rows_are_cards_that_keep_the_roles_of_a_table(visit: Visit) -> None:
    page = visit.open("/", width=390)
    row = page.locator("#board-rows tr[id^='e-']").first
    assert row.get_attribute("role") == "row"
    box = row.bounding_box()
    assert box is not None
    assert box["width"] <= 390
    assert box["height"] == 64


@pytest.mark.parametrize("path", ["/entries/s0000005kq", "/entries/l0000000kq", PATHS[9]])
@pytest.mark.parametrize("width", [390, 820])
def test_no_text_of_a_drawing_is_smaller_than_ten_pixels(
    visit: Visit, path: str, width: int
) -> None:
    page = visit.open(path, width=width)
    sizes = page.locator("main svg text:visible").evaluate_all(
        "texts => texts.map((text) => { const {a, b} = text.getScreenCTM();"
        " return parseFloat(getComputedStyle(text).fontSize) * Math.hypot(a, b); })"
    )
    assert min(sizes) >= 10


def test_slanted_labels_under_bars_stay_in_the_drawing(visit: Visit) -> None:
    for width, scheme in ((390, "light"), (390, "dark"), (1440, "light")):
        page = visit.open("/entries/l0000000kq", width=width, color_scheme=scheme)
        bars = page.locator("svg.bars")
        box = bars.bounding_box()
        assert box is not None
        for label in bars.locator("text").all():
            own = label.bounding_box()
            assert own is not None
            assert own["x"] >= box["x"]
            assert own["y"] >= box["y"]
            assert own["y"] + own["height"] <= box["y"] + box["height"]


def test_no_interval_of_the_board_is_dashed(visit: Visit) -> None:
    page = visit.open("/")
    dashes = page.locator("#board-rows .pm svg *").evaluate_all(
        "marks => marks.map((mark) => getComputedStyle(mark).strokeDasharray)"
    )
    assert set(dashes) == {"none"}


def test_the_print_shows_the_table_and_no_tools(visit: Visit) -> None:
    page = visit.open("/", color_scheme="dark")
    page.emulate_media(media="print")
    assert page.evaluate("getComputedStyle(document.body).color") == "rgb(23, 25, 29)"
    assert page.locator("#board-rows").is_visible()
    for tool in (".top", ".bar", ".cta", ".exp"):
        assert not page.locator(tool).first.is_visible()
    assert page.inner_text(".hero .eyebrow a") == "Sample"
    for name, said in (("half-a-file", "62.00 % answered"), ("FREEZE", "Stands still")):
        flag = page.locator(f"tr:has(.pn:text-is('{name}')) .flag")
        assert flag.is_visible()
        assert said in flag.inner_text()
        words = flag.locator(".vh") if name == "FREEZE" else flag
        box = words.bounding_box()
        assert box is not None
        assert box["width"] > 50
    counted = page.locator("tr:has(.pn:text-is('FREEZE')) .flag")
    counted.evaluate(
        "(flag) => flag.querySelector('.vh').insertAdjacentHTML('beforebegin', '<i>3</i>')"
    )
    count, told = (counted.locator(part).bounding_box() for part in ("i", ".vh"))
    assert count is not None
    assert told is not None
    assert told["x"] >= count["x"] + count["width"] + 3


def test_heat_cells_can_be_read_in_both_themes(visit: Visit) -> None:
    for scheme in ("light", "dark"):
        page = visit.open("/", color_scheme=scheme)
        ratios = page.evaluate(CONTRAST)
        assert len(ratios) == 10
        assert min(ratios) >= 4.5


CONTRAST = """() => {
  const light = (text) => {
    const [r, g, b] = text.match(/\\d+/g).slice(0, 3).map((v) => v / 255)
      .map((v) => (v <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  return [...Array(10).keys()].map((step) => {
    const cell = document.body.appendChild(document.createElement("i"));
    cell.className = `h${step}`;
    const style = getComputedStyle(cell);
    const [low, high] = [light(style.color), light(style.backgroundColor)].sort((a, b) => a - b);
    return (high + 0.05) / (low + 0.05);
  });
}"""


def test_addresses_in_the_page_lead_somewhere(visit: Visit) -> None:
    page = visit.open("/")
    anchors = page.evaluate(
        "[...document.querySelectorAll('a')].map((a) => a.getAttribute('href'))"
    )
    local = {anchor.split("#")[0] for anchor in anchors if anchor.startswith("/")}
    for path in sorted(local):
        if path and not re.match(r"/api/", path):
            answer = page.request.get(visit.address + path)
            assert answer.status == 200, path


@pytest.mark.parametrize("path", ["/", "/entries/s0000000kq", "/splits/sample"])
def test_no_link_tells_another_site_where_it_was_followed(visit: Visit, path: str) -> None:
    kinds = (
        visit.open(path)
        .locator("a[href^=http]")
        .evaluate_all("links => links.filter((a) => a.host !== location.host).map((a) => a.rel)")
    )
    assert kinds
    assert all("noreferrer" in kind for kind in kinds), kinds


@pytest.mark.parametrize("path", ["/", "/?phase=strategy"])
def test_a_tablet_shows_every_number_of_the_board_without_scrolling(
    visit: Visit, path: str
) -> None:
    page = visit.open(path, width=820)
    card = page.locator(".scroll.b").bounding_box()
    edges = page.locator("#board-rows tbody td:is(.pm, .dg):visible").evaluate_all(
        "cells => cells.map((cell) => cell.getBoundingClientRect().right)"
    )
    assert card is not None
    assert len(edges) >= 4
    assert max(edges) <= card["x"] + card["width"] + 0.5


def test_the_foot_explains_lines_and_bars_where_rows_have_them(visit: Visit) -> None:
    page = visit.open("/")
    shown = []
    for width in (390, 820, 1440):
        page.set_viewport_size({"width": width, "height": 900})
        lines = page.locator("#board-rows tbody .wk:visible").count()
        words = page.locator("#board .foot").inner_text()
        assert ("A row's line spans" in words) == ("± and bars: " in words) == (lines > 0)
        assert "±: " in words or lines
        shown.append(lines > 0)
    assert shown == [True, False, True]


ABOVE_ITS_NUMBERS = """rows => rows.map((row) => {
  const box = row.getBoundingClientRect(), name = row.querySelector(".pn");
  const words = [...row.querySelectorAll("td:is(.pm, .dg)")].map((cell) => {
    const text = document.createRange();
    text.selectNodeContents(cell);
    return text.getBoundingClientRect();
  });
  return {
    height: box.height,
    isWhole: name.scrollWidth <= name.clientWidth,
    isClear: words.every((one) => one.top >= name.getBoundingClientRect().bottom - 2),
    isInside: words.every((one) => one.bottom <= box.bottom),
  };
})"""


def test_on_a_tablet_names_run_over_their_numbers_in_rows_of_one_height(visit: Visit) -> None:
    page = visit.open("/", width=820)
    rows = page.eval_on_selector_all("#board-rows tr[id^='e-']", ABOVE_ITS_NUMBERS)
    assert len({row["height"] for row in rows}) == 1
    assert rows[0]["height"] <= 50
    assert all(row["isWhole"] and row["isClear"] and row["isInside"] for row in rows)


def test_a_long_name_stays_in_its_column_of_each_against_each(visit: Visit) -> None:
    page = visit.open("/compare?more=s0000000kq&more=s0000001kq&more=s0000002kq")
    name = page.locator(".vsall tbody th").first
    name.evaluate("it => { it.textContent = 'A name of many words, as papers have, '.repeat(4); }")
    assert name.evaluate("it => it.scrollWidth <= it.clientWidth")


def test_the_phases_can_be_read_on_a_phone_without_scrolling_sideways(visit: Visit) -> None:
    page = visit.open("/submit", width=390)
    edges = page.evaluate(RIGHT_EDGES, ".phs tbody tr:nth-child(2)")
    assert len(edges) == 7
    assert max(edges) <= 390
    heads = page.locator(".phs thead th").all_text_contents()[1:]
    told = page.locator(".phs tbody tr").first.locator("td")
    assert [told.nth(at).get_attribute("data-k") for at in range(6)] == heads


def test_drawings_and_names_of_families_keep_their_size_on_a_tablet(visit: Visit) -> None:
    page = visit.open("/", width=820)
    chart = page.locator("#compare .chart.dots").bounding_box()
    assert chart is not None
    assert chart["width"] <= 520
    name = page.locator(".heat .hn").first
    name.evaluate("it => { it.textContent = 'A name of many words, as papers have, '.repeat(4); }")
    heights = page.eval_on_selector_all(
        ".heat tbody tr", "rows => rows.map((row) => row.getBoundingClientRect().height)"
    )
    assert max(heights) <= 60


@pytest.mark.parametrize("path", ["/", "/submit", "/api", "/entries/s0000000kq", "/phases/sample"])
def test_every_block_of_commands_can_be_copied(visit: Visit, path: str) -> None:
    page = visit.open(path)
    blocks = page.locator("pre")
    assert blocks.count()
    page.wait_for_selector(".copy", state="attached")
    without = blocks.evaluate_all(
        "all => all.filter((one) => !one.querySelector('.copy')).map((one) => one.innerText)"
    )
    assert without == []


@pytest.mark.parametrize("width", [320, 820])
def test_the_menu_of_columns_stays_on_the_screen(visit: Visit, width: int) -> None:
    page = visit.open("/", width=width)
    page.click("details.more summary")
    box = page.locator(".pop").bounding_box()
    assert box is not None
    assert 0 <= box["x"]
    assert box["x"] + box["width"] <= width


def test_on_a_phone_the_scores_of_every_task_can_be_seen_without_scrolling(visit: Visit) -> None:
    page = visit.open("/entries/s0000000kq", width=360)
    edges = page.evaluate(RIGHT_EDGES, ".tasks-table tbody tr:nth-child(2)")
    assert len(edges) == 4  # name, samples, and the two metrics that rank; no outcome, so no bar
    assert max(edges) <= 360
