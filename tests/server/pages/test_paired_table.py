"""Two entries compared sample by sample, on the compare page."""

from typing import Any

from exceptiondrive_schemas.board import Board, PairedComparison
from exceptiondrive_schemas.printable import MINUS
from exceptiondrive_schemas.score_sheet import PairedDifference
from exceptiondrive_server.boards.comparison import Comparison
from exceptiondrive_server.web.numbers import Digits

SURE = PairedDifference(
    difference=0.0409, interval=(0.0112, 0.0713), discordant=0.3083, verdict="Kestrel-2 is better"
)
OPEN = PairedDifference(
    difference=-0.01, interval=(-0.05, 0.03), discordant=0.2, verdict="not separable on this split"
)


def with_pair(board: Board, first: PairedDifference) -> Board:
    a, b = board.entries[0].submission_id, board.entries[2].submission_id
    overall = {"hcc": first, "ur": OPEN}
    pair = PairedComparison(a=a or "", b=b or "", overall=overall, families={"lane_blockage": OPEN})
    return board.model_copy(update={"comparisons": (pair,)})


def test_a_pair_that_the_board_carries_is_judged_by_its_own_interval(lively_board: Board) -> None:
    board = with_pair(lively_board, SURE)
    both = Comparison(board, board.entries[0], board.entries[2], Digits())
    assert both.verdict.endswith(
        "Sample by sample, the difference in HCC is +1.12 to +7.13 points (95\u202f% interval): "
        "Kestrel-2 is better."
    )
    assert both.paired is not None
    assert [found.discordant for found in both.paired.overall.values()] == [0.3083, 0.2]
    assert list(both.paired.families) == ["lane_blockage"]


def test_the_other_order_turns_the_numbers_and_not_the_verdict(lively_board: Board) -> None:
    board = with_pair(lively_board, SURE)
    turned = Comparison(board, board.entries[2], board.entries[0], Digits())
    assert turned.paired is not None
    found = turned.paired.overall["hcc"]
    assert turned.digits.signed(turned.first, found.difference) == f"{MINUS}4.09"
    interval = turned.digits.interval(turned.first, found.interval, signed=True)
    assert interval == f"{MINUS}7.13 to {MINUS}1.12"
    assert found.verdict == "Kestrel-2 is better"


def test_an_interval_over_zero_settles_nothing(lively_board: Board) -> None:
    board = with_pair(lively_board, OPEN)
    both = Comparison(board, board.entries[0], board.entries[2], Digits())
    assert both.verdict.endswith("this split does not settle which is better.")


def test_without_a_pair_the_rank_intervals_speak(lively_board: Board) -> None:
    first, second = lively_board.entries[:2]
    both = Comparison(lively_board, first, second, Digits())
    assert both.paired is None
    assert "The ranks that each could have overlap" in both.verdict


async def test_the_page_shows_the_table_where_there_is_one(site: Any, lively_board: Board) -> None:
    site.create_phase("sample")
    site.publish(with_pair(lively_board, SURE))
    ids = [entry.submission_id for entry in lively_board.entries]
    text = (await site.get(f"/compare?phase=sample&a={ids[0]}&b={ids[2]}")).text
    assert "Sample by sample" in text
    assert "+1.12 to +7.13" in text
    assert "30.83 %" in text
    other = (await site.get(f"/compare?phase=sample&a={ids[0]}&b={ids[1]}")).text
    assert 'id="paired"' not in other
    assert "The ranks that each could have overlap" in other
