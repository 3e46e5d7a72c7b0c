"""The board page over real records."""

import csv
import gzip
import io
import re
import struct
from datetime import UTC, datetime, timedelta
from html import unescape
from typing import Any

import pytest
from tests.server.pages.invented_board import LONG_AGO
from tests.server.pages.reading import read

from exceptiondrive_schemas.api.phase_settings import PhasePolicy
from exceptiondrive_schemas.board import Board, FamilyCell
from exceptiondrive_server.boards.charts import best_entries
from exceptiondrive_server.boards.entry_facts import entry_key
from exceptiondrive_server.web.static_files import STATIC, STYLES

AGO, AGO_TOO = LONG_AGO, LONG_AGO + timedelta(hours=1)
AHEAD = datetime(2090, 5, 5, 9, 30, tzinfo=UTC)
MAX_BYTES_TO_PAINT = 39_000
"""Compressed: what a slow line brings before a phone shows anything."""


async def test_the_board_page_shows_the_ranked_entries(lively_site: Any) -> None:
    answer = await lively_site.get("/")
    assert answer.status_code == 200
    assert "Kestrel-2" in answer.text
    assert answer.text.index("Kestrel-2</a>") < answer.text.index("LaneKeeper XL")


async def test_without_any_phase_the_page_says_what_an_organizer_does(site: Any) -> None:
    answer = await site.get("/")
    assert answer.status_code == 200
    assert "There is no phase yet" in answer.text


async def test_a_seventh_family_has_its_tile_inside_the_box(site: Any, lively_board: Board) -> None:
    head = lively_board.families[0].model_copy(update={"id": "wild_animal", "title": "Wild Animal"})
    entries = tuple(
        entry.model_copy(
            update={"families": {**entry.families, head.id: entry.families["sudden_emergence"]}}
        )
        if entry.families
        else entry
        for entry in lively_board.entries
    )
    site.create_phase("sample")
    site.publish(
        lively_board.model_copy(
            update={"families": (*lively_board.families, head), "entries": entries}
        )
    )
    text = (await site.get("/")).text
    boxes = re.findall(r'<svg class="tiles" viewBox="0 0 (\d+) 12".*?</svg>', text)
    rows = re.findall(r'<svg class="tiles".*?</svg>', text)
    assert set(boxes) == {"175"}
    for row in rows:
        ends = [
            float(x) + float(width) for x, width in re.findall(r' x="(.*?)" width="(.*?)"', row)
        ]
        assert len(ends) == 7
        assert max(ends) <= 175


async def test_a_phase_without_a_board_says_so(site: Any) -> None:
    site.create_phase("sample")
    answer = await site.get("/?phase=sample")
    assert answer.status_code == 200
    assert "No board has been published for" in answer.text


async def test_an_empty_board_invites_the_first_entry(site: Any, empty_board: Board) -> None:
    site.create_phase("sample")
    site.publish(empty_board)
    answer = await site.get("/")
    assert "Nobody has been scored on this board." in answer.text
    assert "Which planner keeps clear of the hazard?" in answer.text


@pytest.mark.parametrize("path", ["/history", "/feed.atom", "/export/board.csv"])
async def test_without_a_phase_there_is_none_yet(site: Any, path: str) -> None:
    answer = await site.get(path)
    assert answer.status_code == 404
    assert "There is no phase yet." in answer.text


async def test_a_family_says_its_share_of_the_samples(lively_site: Any) -> None:
    said = "<small>n = 62</small><small>25.8 % of samples</small>"
    assert said in (await lively_site.get("/")).text


@pytest.mark.parametrize(
    "path",
    [
        "/?phase=unknown",
        "/?phase=sample&board=99",
        "/?protocol=9.9",
        "/?as_of=1999-01-01",
    ],
)
async def test_what_does_not_exist_is_a_404_page_with_a_way_back(
    lively_site: Any, path: str
) -> None:
    answer = await lively_site.get(path)
    assert answer.status_code == 404
    assert answer.headers["content-type"].startswith("text/html")
    assert 'href="/"' in answer.text


@pytest.mark.parametrize(
    ("as_of", "words"),
    [
        ("yesterday", "such as 2026-11-21"),
        ("0001-01-01T00:00:00%2B05:00", "within the years 1 to 9999"),
    ],
)
async def test_a_date_that_is_none_is_told_what_is_wrong(
    lively_site: Any, as_of: str, words: str
) -> None:
    answer = await lively_site.get(f"/?as_of={as_of}")
    assert (answer.status_code, words in answer.text) == (400, True)


REFUSED = (
    "sort=nonsense",
    "sort=--ur",
    "sort=HCC",
    "sort=accuracy",
    "as_of=yesterday",
    "as_of=2000-01-01&protocol=1.0",
    "view=late&protocol=1.0",
    "view=early",
    "challenge=chess",
)


@pytest.mark.parametrize("query", REFUSED)
async def test_page_exports_and_api_refuse_the_same_in_the_same_words(
    lively_site: Any, query: str
) -> None:
    refused = await lively_site.get(f"/api/v1/leaderboard?{query}", accept="*/*")
    assert (refused.status_code, refused.json()["code"]) == (400, "bad_request")
    assert refused.json()["fields"]
    said = [refused.json()["detail"], *refused.json()["fields"].values()]
    for path in ("/", "/export/board.csv", "/export/board.bib", "/pictures/board.png", "/compare"):
        answer = await lively_site.get(f"{path}?{query}")
        if "sort" in query and "--" not in query and path not in ("/", "/export/board.csv"):
            continue  # it sorts nothing
        assert answer.status_code == 400, path
        assert all(words in unescape(answer.text) for words in said), path


@pytest.mark.parametrize("sort", ["ur", "-ur", "-hcc", "method", "-date", "rank", None])
async def test_the_same_sort_is_the_same_order_on_page_api_and_csv(
    lively_site: Any, sort: str | None
) -> None:
    query = f"?sort={sort}" if sort else ""
    board = Board.model_validate_json(
        (await lively_site.get(f"/api/v1/leaderboard{query}")).content
    )
    wanted = [entry.method for entry in board.entries if entry.source == "scored"]
    assert await shown_order(lively_site, query) == [wanted, wanted, wanted]


async def test_the_same_filter_is_the_same_rows_on_page_api_and_csv(lively_site: Any) -> None:
    query = "?q=aurora&source=scored"
    answer = await lively_site.get(f"/api/v1/leaderboard{query}")
    wanted = [entry.method for entry in Board.model_validate_json(answer.content).entries]
    assert wanted == ["LaneKeeper XL (bypass head, 3 s)", "half-a-file"]
    assert await shown_order(lively_site, query) == [wanted, wanted, wanted]


async def shown_order(site: Any, query: str) -> list[list[str]]:
    """Return the scored methods as the page, the CSV and the API's CSV list them."""
    text = (await site.get(f"/{query}")).text
    rows = "".join(re.findall(r'(?s)class="blk-(?:scored|listed)".*?</tbody>', text))
    found = [[unescape(name) for name in re.findall(r'class="pn"[^>]*>([^<]*)</a>', rows)]]
    for path in ("/export/board.csv", "/api/v1/leaderboard.csv"):
        lines = csv.DictReader(io.StringIO((await site.get(f"{path}{query}")).text))
        found.append([line["method"] for line in lines if line["source"] == "scored"])
    return found


async def test_a_board_stands_by_rank_wherever_nobody_asks_for_another_order(
    lively_site: Any,
) -> None:
    found = await shown_order(lively_site, "")
    board = Board.model_validate_json((await lively_site.get("/api/v1/leaderboard")).content)
    assert found[0] == [entry.method for entry in board.entries if entry.source == "scored"]
    assert found[0] == found[1] == found[2]
    assert found == await shown_order(lively_site, "?sort=rank")
    assert found != await shown_order(lively_site, "?sort=-ur")


async def test_an_address_with_an_order_in_words_leads_to_the_one_with_a_sign(
    lively_site: Any,
) -> None:
    answer = await lively_site.get("/?sort=ur&order=descending")
    assert (answer.status_code, answer.headers["location"]) == (303, "/?sort=-ur#board")


async def test_an_unchanged_page_is_answered_by_304(lively_site: Any) -> None:
    first = await lively_site.get("/")
    again = await lively_site.get("/", if_none_match=first.headers["etag"])
    assert (again.status_code, again.content) == (304, b"")
    other = await lively_site.get("/?sort=ur", if_none_match=first.headers["etag"])
    assert other.status_code == 200


async def test_the_policy_forbids_everything_foreign_and_inline(lively_site: Any) -> None:
    answer = await lively_site.get("/")
    policy = answer.headers["content-security-policy"]
    assert policy.startswith("default-src 'none'; ")
    assert "unsafe" not in policy
    assert not re.search(r"<script(?![^>]*\bsrc=\"/static/)", answer.text)
    assert not re.search(r"<style|\sstyle=|\son[a-z]+=|javascript:", answer.text)
    assert not re.search(
        r'(?:src|href|action)="(?:https?:)?//(?!example\.org|site\.test/)', answer.text
    )


async def test_a_page_and_its_styles_script_and_fonts_weigh_little(
    lively_site: Any,
) -> None:
    answer = await lively_site.get("/")
    assert len(answer.content) < 150_000
    assets = set(re.findall(r'"(/static/[^"]+)"', answer.text))
    fetched = [await lively_site.get(asset) for asset in assets]
    assert all(asset.status_code == 200 for asset in fetched)
    assert sum(len(asset.content) for asset in fetched) < 155_000


async def test_static_files_named_by_content_are_kept_for_ever(lively_site: Any) -> None:
    asset = re.search(r'"(/static/site\.css\?v=[^"]+)"', (await lively_site.get("/")).text)
    assert asset is not None
    answer = await lively_site.get(asset[1])
    assert "immutable" in answer.headers["cache-control"]
    assert (await lively_site.get("/static/site.css")).headers["cache-control"] == "no-cache"
    for name in (
        "site.css",
        "board.js",
    ):  # of a page of another version, which another process gave
        other = await lively_site.get(f"/static/{name}?v=0123456789")
        assert (other.status_code, other.headers["cache-control"]) == (200, "no-cache")


async def test_the_filter_form_leads_to_a_short_address(lively_site: Any) -> None:
    answer = await lively_site.get(
        "/?phase=sample&protocol=&average=micro&q=&offered=hpr,cts&show=hpr&as_of=&apply=1"
    )
    assert answer.status_code == 303
    assert answer.headers["location"] == "/?phase=sample&average=micro&hide=cts#board"


async def test_an_old_board_keeps_its_address_and_says_that_it_is_old(
    lively_site: Any, empty_board: Board
) -> None:
    lively_site.publish(empty_board)
    assert "Kestrel-2" not in (await lively_site.get("/")).text
    old = await lively_site.get("/?phase=sample&board=1")
    assert "Kestrel-2" in old.text
    assert "It is not the current one" in old.text


async def test_the_theme_is_kept_in_a_cookie_without_script(lively_site: Any) -> None:
    answer = await lively_site.post("/theme", {"choice": "dark", "back": "/?sort=ur"})
    assert (answer.status_code, answer.headers["location"]) == (303, "/?sort=ur")
    page = await lively_site.get("/", cookie="theme=dark")
    assert '<html lang="en" data-theme="dark">' in page.text
    assert "data-theme" not in (await lively_site.get("/", cookie="theme=purple")).text


@pytest.mark.parametrize("back", ["https://evil.test/", "//evil.test", "/\\evil.test", "x", "/\n"])
async def test_the_theme_switch_never_leads_off_this_site(site: Any, back: str) -> None:
    answer = await site.post("/theme", {"choice": "light", "back": back})
    assert answer.headers["location"] == "/"


async def test_a_long_board_is_paged_and_still_weighs_less_than_150_kilobytes(
    site: Any, lively_board: Board
) -> None:
    first, others = lively_board.entries[0], lively_board.entries[7:]
    many = tuple(
        first.model_copy(update={"rank": n + 1, "submission_id": f"s{n:07d}", "method": f"P {n}"})
        for n in range(1000)
    )
    site.create_phase("sample")
    site.publish(lively_board.model_copy(update={"entries": (*many, *others)}))
    answer = await site.get("/")
    assert len(answer.content) < 150_000
    assert "Page 1 of 50, 1,002 entries" in answer.text
    last = await site.get("/?page=50")
    assert ">P 999</a>" in last.text


async def test_the_strategy_challenge_has_a_board_of_its_own_metrics(
    site: Any, strategy_board: Board
) -> None:
    site.create_phase("strategy", "strategy")
    site.publish(strategy_board)
    text = (await site.get("/?phase=strategy")).text
    assert "Under-warning" in text
    assert "61.25" in text
    assert "HCC" not in text.split('<section id="board"')[1].split('id="submit"')[0]
    assert "Even the leading agent is too careless in about 2 of 7 samples." in text
    assert "% Accuracy or more</span>" in text
    right = FamilyCell.model_validate({"n": 9, "accuracy": 1.0})
    entries = tuple(
        entry.model_copy(update={"families": dict.fromkeys(entry.families, right)})
        for entry in strategy_board.entries
    )
    site.create_phase("full", "strategy")
    site.publish(strategy_board.model_copy(update={"phase": "full", "entries": entries}))
    full = (await site.get("/?phase=full")).text
    assert re.search(r"<span>100\W+Accuracy</span>", full), "more than all there is not"
    assert "exceptiondrive check agent.json.gz</b> \\\n<b>    <i>--phase</i> strategy</b>" in text
    assert (await site.get("/compare?phase=strategy")).status_code == 200
    assert (await site.get("/entries/a0000000kq?phase=strategy")).status_code == 200


@pytest.mark.parametrize(
    ("dates", "words"),
    [
        ({}, "Open for submissions"),
        ({"closes_at": AHEAD}, "Open until 5 May 2090, 09:30 UTC"),
        ({"opens_at": AHEAD}, "Opens 5 May 2090, 09:30 UTC"),
        ({"opens_at": AGO, "closes_at": AGO_TOO}, "Closed since 4 May 2020, 10:30 UTC"),
    ],
)
async def test_a_phase_says_whether_it_takes_submissions(
    site: Any, dates: dict[str, datetime], words: str
) -> None:
    site.create_phase("sample", **dates)
    board = (await site.get("/?phase=sample")).text
    assert words in re.sub("<[^>]+>", "", board)
    start = (await site.get("/submit?phase=sample")).text
    is_open = words.startswith("Open ")
    assert ("takes no submissions now" in start) == (not is_open)


async def test_a_phase_without_a_board_leaves_the_others_in_reach(lively_site: Any) -> None:
    lively_site.create_phase("unpublished")
    assert 'href="/?phase=sample#board"' in (await lively_site.get("/?phase=unpublished")).text


@pytest.mark.parametrize(
    ("policy", "closes_at", "words"),
    [
        ({}, None, "even if it is worse; withdraw it, and the previous one counts again. Then"),
        ({}, AHEAD, "withdraw it before the deadline, and the previous one counts again; later its place stays"),
        ({"run_choice": "team"}, AHEAD, "unless the team chooses before the deadline: the best, or"),
        ({"entries_shown": "chosen"}, None, "One entry of each team counts: the one that it chose,"),
    ],
)  # fmt: skip
async def test_the_quick_start_says_which_run_of_a_method_counts(
    site: Any, policy: dict[str, Any], closes_at: datetime | None, words: str
) -> None:
    site.create_phase("sample", policy=PhasePolicy(**policy), closes_at=closes_at)
    assert words in " ".join((await site.get("/submit?phase=sample")).text.split())


async def test_a_board_that_tells_no_family_offers_none(site: Any, lively_board: Board) -> None:
    """Cells below the least size hold their n alone, as every family of a small withheld split."""
    counts = {
        head.id: FamilyCell(n=head.n, metrics={"hcc": None, "ur": None})
        for head in lively_board.families
    }
    untold = [each.model_copy(update={"families": counts}) for each in lively_board.entries]
    offers = ("Which hazards are hardest", "family.lane_blockage", "your scores by family")
    site.create_phase("sample")
    for entries, tells in ((lively_board.entries, True), (tuple(untold), False)):
        number = lively_board.board + (not tells)
        site.publish(lively_board.model_copy(update={"entries": entries, "board": number}))
        text = " ".join((await site.get("/?phase=sample")).text.split())
        assert [words in text for words in offers] == [tells] * 3


async def test_the_quick_start_says_so_where_a_phase_takes_nothing(lively_site: Any) -> None:
    lively_site.create_phase("past", opens_at=AGO, closes_at=AGO_TOO)
    text = (await lively_site.get("/submit?phase=past")).text
    assert "Past takes no submissions now: closed since 4 May 2020, 10:30 UTC." in text
    assert "What follows is for Sample." in text
    assert 'data-k="Opens">from the start<' in text
    assert 'data-k="Closes">4 May 2020, 10:30 UTC<' in text


@pytest.mark.parametrize(
    ("dates", "word"),
    [
        ({}, None),
        ({"opens_at": AGO}, None),
        ({"opens_at": AHEAD}, "opens 5 May 2090"),
        ({"opens_at": AGO, "closes_at": AGO_TOO}, "closed"),
    ],
)
async def test_a_phase_is_offered_with_a_word_where_it_is_not_open(
    lively_site: Any, dates: dict[str, datetime], word: str | None
) -> None:
    lively_site.create_phase("other", **dates)
    page = " ".join((await lively_site.get("/")).text.split())
    assert ("Other <small>" in page) == (word is not None)
    assert word is None or f"Other <small>{word}</small>" in page


async def test_the_quick_start_of_a_phase_that_opens_later_is_its_own(lively_site: Any) -> None:
    lively_site.create_phase("later", opens_at=AHEAD)
    text = " ".join((await lively_site.get("/submit?phase=later")).text.split())
    assert "Later takes no submissions now: it opens 5 May 2090, 09:30 UTC." in text
    assert "What follows is for" not in text


async def test_each_font_is_asked_for_under_one_address(lively_site: Any) -> None:
    text = (await lively_site.get("/")).text
    preloaded = set(re.findall(r'<link\s+rel="preload"[^>]*\shref="([^"]+)"', text))
    (sheet,) = re.findall(r'<link rel="stylesheet" href="([^"]+)"', text)
    style = (await lively_site.get(sheet)).text
    assert preloaded == set(re.findall(r"url\((/[^)]+)\)", style))
    assert len(preloaded) == 2
    kept = {(await lively_site.get(font)).headers["cache-control"] for font in preloaded}
    assert kept == {"public, max-age=31536000, immutable"}


async def test_a_phone_paints_after_little_more_than_the_page_and_its_style(
    lively_site: Any,
) -> None:
    page = await lively_site.get("/")
    links = re.findall(r"<link\s[^>]*>", page.text)
    preloads = [link for link in links if 'rel="preload"' in link]
    assert len(preloads) == 2
    assert all('media="(min-width: 600px)"' in link for link in preloads)
    scripts = re.findall(r"<script\s[^>]*>", page.text)
    assert scripts
    assert all(" defer" in script for script in scripts)
    (sheet,) = re.findall(r'<link rel="stylesheet" href="([^"]+)"', page.text)
    style = await lively_site.get(sheet)
    assert sum(len(gzip.compress(one.content)) for one in (page, style)) < MAX_BYTES_TO_PAINT


async def test_all_sources_of_the_style_are_one_sheet(lively_site: Any) -> None:
    (sheet,) = set(re.findall(r'"(/static/[^"]+\.css[^"]*)"', (await lively_site.get("/")).text))
    style = (await lively_site.get(sheet)).text
    alone = STATIC / "story.css"  # of a page that stands in a folder, too
    sources = sorted(set(STATIC.glob("*.css")) - {alone})
    assert {source.stem for source in sources} == set(STYLES)
    assert all(source.read_text().splitlines()[-1] in style for source in sources)


@pytest.mark.parametrize("query", ["", "&board=2", "&board=1", "&sort=ur"])
async def test_search_engines_keep_the_live_board(
    lively_site: Any, lively_board: Board, query: str
) -> None:
    lively_site.publish(lively_board.model_copy(update={"entries": lively_board.entries[:3]}))
    text = (await lively_site.get(f"/?phase=sample{query}")).text
    assert '<link rel="canonical" href="http://site.test/?phase=sample">' in text


async def test_every_address_of_the_sitemap_can_be_read(lively_site: Any) -> None:
    robots = (await lively_site.get("/robots.txt")).text
    assert "Sitemap: http://site.test/sitemap.xml" in robots.splitlines()
    listed = re.findall("<loc>(.*?)</loc>", (await lively_site.get("/sitemap.xml")).text)
    paths = [unescape(each).removeprefix("http://site.test") for each in listed]
    assert {"/", "/?phase=sample", "/entries/s0000000kq", "/protocols/1.0"} <= set(paths)
    answers = {path: (await lively_site.get(path)).status_code for path in paths}
    assert [path for path, status in answers.items() if status != 200] == []


async def test_icons_stand_where_browsers_look_for_them(lively_site: Any) -> None:
    ico = (await lively_site.get("/favicon.ico")).content
    size, at = struct.unpack_from("<II", ico, 14)
    assert (ico[:6], at, len(ico)) == (b"\0\0\1\0\1\0", 22, 22 + size)
    for png, side in (
        (ico[at:], 32),
        ((await lively_site.get("/apple-touch-icon.png")).content, 180),
    ):
        assert png[:8] == b"\x89PNG\r\n\x1a\n"
        assert struct.unpack_from(">II", png, 16) == (side, side)


async def test_a_board_of_a_reference_alone_has_no_charts_and_leads_to_submitting_first(
    lively_site: Any, lively_board: Board
) -> None:
    references = tuple(each for each in lively_board.entries if each.source == "reference")[:1]
    lively_site.publish(lively_board.model_copy(update={"entries": references}))
    text = (await lively_site.get("/")).text
    assert references[0].method in text
    assert 'id="chart"' not in text
    assert 'id="families"' not in text
    assert text.index('id="submit"') < text.index('id="metrics"')


async def test_numbers_behind_names_that_begin_alike_are_explained(
    lively_site: Any, lively_board: Board
) -> None:
    words = "(1), (2): names that begin alike, in the order of the board"
    assert words not in (await lively_site.get("/")).text
    one, two, *others = lively_board.entries
    alike = [
        each.model_copy(update={"method": f"Planner with a long name, {end}"})
        for each, end in ((one, "large"), (two, "small"))
    ]
    lively_site.publish(lively_board.model_copy(update={"entries": (*alike, *others)}))
    text = (await lively_site.get("/")).text
    assert "… (2)" in text
    assert words in text


async def test_chosen_entries_join_the_charts_without_script(
    lively_site: Any, lively_board: Board
) -> None:
    usual = best_entries(lively_board)
    other = next(
        e
        for e in lively_board.entries[::-1]
        if e.source != "reported" and e.families and e not in usual
    )
    plain = read((await lively_site.get("/")).text)
    asked = read((await lively_site.get(f"/?more={entry_key(other)}&more=nobody")).text)
    keys = [
        {key.text for key in page.one("section", id="families").all("span", "key")}
        for page in (plain, asked)
    ]
    assert (other.method in keys[0], other.method in keys[1]) == (False, True)
    assert best_entries(lively_board, [entry_key(other)])[:2] == (usual[0], other)
    sort = next(a for a in asked.all("a") if "sort=ur" in (a["href"]))
    assert f"more={entry_key(other)}" in sort["href"]


async def test_page_and_api_say_how_intervals_are_found(
    lively_site: Any, lively_board: Board
) -> None:
    about = read((await lively_site.get("/")).text).one("section", id="about").text
    assert f"95 %, 1,000 draws: {lively_board.interval_method}" in about
    assert (
        '"interval_method":"expanded percentile bootstrap over scenes'
        in lively_board.model_dump_json()
    )


async def test_a_phase_that_was_put_away_promises_nothing(site: Any) -> None:
    site.create_phase("open")
    site.create_phase("past", visibility="archived")
    page = read((await site.get("/phases/past")).text)
    facts = page.one("dl", "facts").text
    assert "Closes archived" in facts
    assert "Submissions none are taken" in facts
    rows = {
        row.one("code").text: row
        for row in read((await site.get("/submit")).text).all("tr")[1:]
        if row.all("code")
    }
    assert [cell.text for cell in rows["past"].all("td")[3:5]] == ["archived", "none"]
    assert [cell.text for cell in rows["open"].all("td")[3:5]] == ["never", "3"]
