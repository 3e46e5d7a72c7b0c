"""What changed since the board before, in one line; and boards of the past say that they are."""

import re
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

import pytest
from tests.server.pages.invented_board import MANIFEST

from exceptiondrive_schemas.board import Board, EntryNews
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_server.boards.headline import BoardBefore, change_line
from exceptiondrive_server.boards.page import BoardPage
from exceptiondrive_server.boards.query import BoardQuery
from exceptiondrive_server.web.templating import macro

AT = datetime(2026, 11, 20, 9, 0, tzinfo=UTC)
BEFORE = BoardBefore(6, "1.0", MANIFEST.revision, None, AT)


def with_ranks(board: Board, previous: dict[int, int | None]) -> Board:
    """The ranked entries, with the rank that each had before; where none is given, the same."""
    entries = tuple(
        entry.model_copy(update={"previous_rank": previous.get(entry.rank or 0, entry.rank)})
        for entry in board.entries
        if entry.rank is not None
    )
    return board.model_copy(update={"entries": entries})


def test_entries_and_moves_are_counted_and_a_few_are_named(lively_board: Board) -> None:
    board = with_ranks(lively_board, {3: None, 1: 2, 2: 1})
    assert change_line(board, BEFORE).words == (
        "Since board 6 of 20 Nov 2026: 1 newly ranked (brake-late to rank 3); "
        "1 moved up (Kestrel-2 to rank 1); "
        "1 moved down (LaneKeeper XL (bypass head, 3 s) to rank 2)."
    )


def test_many_are_counted_and_not_named(lively_board: Board) -> None:
    board = with_ranks(lively_board, dict.fromkeys(range(1, 5)))
    assert change_line(board, BEFORE).words == "Since board 6 of 20 Nov 2026: 4 newly ranked."


def test_what_left_is_counted_and_named_with_its_rank(lively_board: Board) -> None:
    gone = EntryNews(
        submission_id="gone",
        method="Cheater",
        team="",
        rank=1,
        before=0.9,
        after=None,
        has_left=True,
    )
    line = change_line(with_ranks(lively_board, {}), replace(BEFORE, left=(gone,)))
    assert line.words == "Since board 6 of 20 Nov 2026: 1 left (Cheater from rank 1)."


def test_a_protocol_update_comes_first_and_leads_to_its_page(
    lively_board: Board, protocol: ProtocolDocument
) -> None:
    board, before = with_ranks(lively_board, {}), replace(BEFORE, protocol="0.9")
    line = change_line(board, before)
    assert line.words == "Since board 6 of 20 Nov 2026: protocol 0.9 became 1.0."
    assert line.has_new_protocol
    page = BoardPage(BoardQuery(), (), None, board, protocol, (), protocol.version, before=before)
    text = macro("boards/table.html", "about_board")(page)
    assert '<a href="/protocols/1.0">What the protocol changed</a>' in text


@pytest.mark.parametrize(
    ("part", "before", "words"),
    [
        ("private", "public", "other samples count: the private part."),
        (None, "public", "other samples count: all samples."),
        ("public", "public", "another revision of the split counts."),
    ],
)
def test_other_samples_are_said_where_no_rank_moved(
    lively_board: Board, part: str | None, before: Any, words: str
) -> None:
    board = with_ranks(lively_board, {}).model_copy(update={"part": part})
    line = change_line(board, replace(BEFORE, split_revision="sha256:" + "9" * 64, part=before))
    assert line.words == f"Since board 6 of 20 Nov 2026: {words}"


def test_nothing_new_and_nothing_before_are_said(lively_board: Board) -> None:
    quiet = change_line(with_ranks(lively_board, {}), BEFORE)
    assert quiet == ("Since board 6 of 20 Nov 2026 no rank moved.", False)
    assert change_line(lively_board, None).words == "This is the first board of its phase."


async def test_the_page_of_an_old_board_says_so_and_leads_to_the_current_one(
    lively_site: Any, lively_board: Board
) -> None:
    between = datetime.now(UTC).isoformat().replace("+00:00", "Z")
    lively_site.publish(with_ranks(lively_board, {1: 2, 2: 1}))
    current = (await lively_site.get("/?phase=sample")).text
    assert "This is history" not in current
    assert "Since board 1 of" in current
    assert "1 moved up (Kestrel-2 to rank 1)" in current
    assert 'href="/history?phase=sample"' in current
    old = (await lively_site.get("/?phase=sample&board=1")).text
    assert "This is history: board 1 of" in old
    then = (await lively_site.get(f"/?phase=sample&as_of={between}")).text
    assert f"This is history, the board as of {between}: board 1 of" in then
    for text in (old, then):
        assert "It is not the current one." in text
        assert '<a href="/?phase=sample#board">Show the current board</a>' in text
        assert "This is the first board of its phase." in text


async def test_the_history_lists_every_board(lively_site: Any, lively_board: Board) -> None:
    lively_site.publish(with_ranks(lively_board, {1: 2, 2: 1}))
    text = (await lively_site.get("/history?phase=sample")).text
    assert text.index("No. 2") < text.index("No. 1")
    assert text.count(">current</span>") == 1
    assert (await lively_site.get("/history?phase=nowhere")).status_code == 404


async def test_without_a_phase_there_is_no_history(site: Any) -> None:
    assert (await site.get("/history")).status_code == 404


async def test_the_form_of_a_board_of_a_date_does_not_contradict_itself(
    lively_site: Any, lively_board: Board
) -> None:
    between = datetime.now(UTC).isoformat().replace("+00:00", "Z")
    lively_site.change_protocol(lively_board)
    then = (await lively_site.get(f"/?as_of={between}")).text
    chosen = re.search(r'<select name="protocol">.*?<option value="([^"]*)" selected>(.*?)<', then)
    assert chosen is not None
    assert chosen.groups() == ("", "1.0 (of that date)")
    assert '<option value="1.1">1.1</option>' in then
