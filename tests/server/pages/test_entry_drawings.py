"""Drawings and history on the page of an entry: what is public, and nothing else."""

import re
from typing import Any

import pytest
from tests.server.pages.reading import read

from exceptiondrive_records.boards.boards import latest_board
from exceptiondrive_records.phases.scoring_keys import ScoringKey
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.board import Board
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.drawing import EntryDrawings
from exceptiondrive_server.web.numbers import Digits

ENTRY = "/entries/s0000000kq"


@pytest.fixture
def drawn_site(lively_site: Any) -> Any:
    lively_site.publish_split()
    lively_site.keep_drawings("s0000000kq")
    return lively_site


async def test_the_page_shows_the_worst_and_the_middle_of_each_family(drawn_site: Any) -> None:
    answer = await drawn_site.get(ENTRY)
    assert answer.text.count('<svg class="draw" viewBox="0 0 430 250"') == 12
    assert len(re.findall(r'href="/entries/s0000000kq/samples/worst-\w+"', answer.text)) == 6
    assert "Where it does worst" in answer.text
    assert len(answer.content) < 150_000
    assert "style=" not in answer.text


async def test_an_entry_without_drawings_says_nothing_of_them(lively_site: Any) -> None:
    text = (await lively_site.get(ENTRY)).text
    assert "How it drove" not in text
    assert 'class="draw"' not in text
    assert (await lively_site.get(f"{ENTRY}/samples/worst-lane_blockage")).status_code == 404


async def test_what_was_withdrawn_is_not_drawn_any_more(
    drawn_site: Any, empty_board: Board
) -> None:
    with drawn_site.database.write() as session:
        session.get_one(Submission, "s0000000kq").status = SubmissionStatus.WITHDRAWN
    drawn_site.publish(empty_board)
    old = "?phase=sample&board=1"
    text = (await drawn_site.get(ENTRY + old)).text
    assert "Kestrel-2" in text
    assert "How it drove" not in text
    answer = await drawn_site.get(f"{ENTRY}/samples/worst-lane_blockage{old}")
    assert answer.status_code == 404


async def test_each_drawn_sample_has_a_page_and_an_unchanged_one_is_answered_by_304(
    drawn_site: Any, lively_board: Board
) -> None:
    links = re.findall(
        r'href="(/entries/s0000000kq/samples/[^"]+)"', (await drawn_site.get(ENTRY)).text
    )
    assert len(links) == 18
    for link in links[:1] + links[-1:]:
        answer = await drawn_site.get(link)
        assert answer.status_code == 200
        assert "exceptiondrive plot" in answer.text
        assert "This sample earns" in answer.text
        assert len(answer.content) < 150_000
        again = await drawn_site.get(link, If_None_Match=answer.headers["etag"])
        assert again.status_code == 304
    assert (await drawn_site.get(f"{ENTRY}/samples/best-of-all")).status_code == 404


async def test_the_drawings_of_an_old_board_stay_with_it(
    drawn_site: Any, lively_board: Board
) -> None:
    drawn_site.change_protocol(lively_board)
    assert "How it drove" not in (await drawn_site.get(ENTRY)).text  # not drawn under 1.1 yet
    old = (await drawn_site.get(f"{ENTRY}?phase=sample&board=1")).text
    link = re.search(r'href="(/entries/s0000000kq/samples/[^"]+)"', old)
    assert link is not None
    assert "board=1" in link[1]
    assert (await drawn_site.get(link[1].replace("&amp;", "&"))).status_code == 200


OUTCOMES = {part.metric for part in PLANNING.words.outcome}


async def test_what_a_sample_earns_is_what_was_drawn(
    drawn_site: Any, real_drawings: EntryDrawings
) -> None:
    for drawn in real_drawings.samples:
        place = f"{drawn.chosen_as}-{drawn.drawing.family}"
        text = (await drawn_site.get(f"{ENTRY}/samples/{place}")).text
        hcc = Digits().text(PLANNING.metrics[0], drawn.drawing.metrics["hcc"])
        assert re.search(rf"HCC</dt>\s*<dd>{hcc}\u202f%", text)
        earned = read(text).one("dl", "earns").text
        outcome = [
            m.label for m in PLANNING.metrics if m.key in OUTCOMES and drawn.drawing.metrics[m.key]
        ]
        assert earned.startswith(f"Outcome {outcome[0]} HCC ")
        assert "UR" not in earned
        n_pictures, n_boxes = 2, len(drawn.drawing.footprints)
        assert n_boxes == 7
        assert text.count('class="box"') == n_pictures * n_boxes + 1  # of the legend


async def test_the_history_names_every_published_protocol_with_rank_score_and_board(
    lively_site: Any, lively_board: Board
) -> None:
    first, *others = lively_board.entries
    worse = first.model_copy(update={"metrics": {**first.metrics, "hcc": 0.5011}, "rank": 2})
    lively_site.change_protocol(lively_board.model_copy(update={"entries": (worse, *others)}))
    text = (await lively_site.get(ENTRY)).text
    history = text[text.index('id="hh"') : text.index("</table>", text.index('id="hh"'))]
    assert re.findall(r'href="/protocols/([\d.]+)"', history) == ["1.1", "1.0"]
    assert "<b>50.11</b>" in history
    assert "<b>61.40</b>" in history
    assert "95\u202f% interval 57.30 to 65.50" in history
    assert "phase=sample&amp;board=1#board" in history
    assert "/entries/s0000000kq?phase=sample&amp;board=1" in history


async def test_a_draft_is_nowhere_to_be_seen(lively_site: Any, lively_board: Board) -> None:
    draft = lively_site.draft(lively_board, "9.87")
    key = ScoringKey(draft.protocol.digest, draft.split.revision)
    with lively_site.database.read() as session:
        assert latest_board(session, "sample", key) is not None
    for path in (ENTRY, "/", "/feed.atom?phase=sample"):
        answer = await lively_site.get(path)
        assert answer.status_code == 200
        assert "9.87" not in answer.text, path


async def test_the_receipt_can_be_fetched_and_checked_in_one_line(
    lively_site: Any, empty_board: Board
) -> None:
    text = (await lively_site.get(ENTRY)).text
    assert 'href="/api/v1/entries/s0000000kq/receipt" download="receipt-s0000000kq.json"' in text
    assert 'href="/api/v1/receipt-keys" download="receipt-keys.json"' in text
    line = re.sub("<[^>]+>", "", text[text.index('<pre class="term one"') :].partition("</pre>")[0])
    assert "exceptiondrive receipt verify receipt-s0000000kq.json --key receipt-keys.json" in line


async def test_an_entry_of_an_old_board_leads_to_its_sheet_and_receipt_and_to_no_badge(
    lively_site: Any, empty_board: Board
) -> None:
    """The badge tells how the entry stands now."""
    assert 'href="/badges/' in (await lively_site.get(ENTRY)).text
    lively_site.publish(empty_board)
    at = "/api/v1/entries/s0000000kq"
    for page in (ENTRY, f"{ENTRY}?phase=sample&board=1"):
        old = (await lively_site.get(page)).text
        links = set(re.findall(r'href="(/(?:api|badges)/[^"]*s0000000kq[^"]*)"', old))
        assert links == {f"{at}?board=1", f"{at}/receipt?board=1"}


async def test_strategy_entries_have_the_same_page_without_drawings(shown_site: Any) -> None:
    text = (await shown_site.get("/entries/a0000000kq?phase=strategy")).text
    assert "Careful agent" in text
    assert "Under-warning" in text
    assert "How it drove" not in text


async def test_a_bar_is_told_part_by_part_in_the_words_of_its_key(shown_site: Any) -> None:
    text = " ".join((await shown_site.get("/entries/a0000000kq?phase=strategy")).text.split())
    assert (
        "Each bar splits the samples of its line into: acceptable; wrong, not too careless; too "
        "careless, or no answer."
    ) in text


async def test_everything_in_a_drawing_has_a_style_in_the_sheet(drawn_site: Any) -> None:
    """What has none is black, also on the dark page; the drawing is made outside of the templates."""
    style = (await drawn_site.get("/static/site.css")).text
    drawings = re.findall(
        r'<svg class="draw" .*?</svg>', (await drawn_site.get(ENTRY)).text, re.DOTALL
    )
    worn = set(re.findall(r'<(?:circle|g|path|poly\w+|text) class="([\w-]+)"', "".join(drawings)))
    assert {"gap", "gap-end", "gap-text", "source-dot", "edited-dot"} < worn
    assert [kind for kind in sorted(worn) if f".{kind}" not in re.findall(r"\.[\w-]+", style)] == []
