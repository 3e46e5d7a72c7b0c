"""Which rows are shown, in which order."""

from typing import Any

import pytest

from exceptiondrive_schemas.board import Board
from exceptiondrive_server.pages.board_query import BoardQuery
from exceptiondrive_server.pages.board_selection import PAGE_ROWS, select


def names(board: Board, **query: Any) -> list[list[str]]:
    page = select(board, BoardQuery(**query), board.headline)
    return [[entry.method for entry in block.entries] for block in page.blocks]


def test_blocks_are_never_mixed_whatever_the_sort(lively_board: Board) -> None:
    for sort in ("rank", "hcc", "ur", "method", "date", "family.lane_blockage"):
        for order in ("ascending", "descending"):
            page = select(lively_board, BoardQuery(sort=sort, order=order), "macro_family")
            assert [block.source for block in page.blocks] == ["scored", "reference", "reported"]
            for block in page.blocks:
                assert {entry.source for entry in block.entries} == {block.source}


def test_by_default_ranks_rise_and_unranked_rows_stand_last(lively_board: Board) -> None:
    page = select(lively_board, BoardQuery(), "macro_family")
    assert [entry.rank for entry in page.blocks[0].entries] == [1, 2, 3, 4, 5, 6, None]


@pytest.mark.parametrize("order", ["ascending", "descending"])
@pytest.mark.parametrize("sort", ["ur", "hcc", "cts", "family.road_surface_hazard"])
def test_a_row_without_the_value_stands_last_in_either_direction(
    lively_board: Board, sort: str, order: str
) -> None:
    assert names(lively_board, sort=sort, order=order)[0][-1] == "half-a-file"


def test_the_first_click_on_a_column_sorts_best_first(lively_board: Board) -> None:
    assert names(lively_board, sort="ur")[0][0] == "Kestrel-2"
    assert names(lively_board, sort="ur", order="descending")[0][0] == "nerve"
    assert names(lively_board, sort="hcc")[2][0] == "ST-P3"


def test_filters_match_method_and_team_whatever_the_case(lively_board: Board) -> None:
    assert names(lively_board, search="HALDEN") == [["Kestrel-2", "nerve"]]
    assert names(lively_board, search="halden kes") == [["Kestrel-2"]]
    assert names(lively_board, source="reference") == [["FREEZE", "CONSTANT VELOCITY"]]
    assert names(lively_board, search="nobody") == []


def test_long_boards_are_cut_into_pages(lively_board: Board) -> None:
    entry = lively_board.entries[0]
    many = tuple(
        entry.model_copy(update={"rank": n + 1, "submission_id": f"s{n}"}) for n in range(95)
    )
    board = lively_board.model_copy(update={"entries": many})
    pages = [select(board, BoardQuery(page=number), "macro_family") for number in (1, 3, 99)]
    assert [len(page.blocks[0].entries) for page in pages] == [PAGE_ROWS, PAGE_ROWS, 15]
    assert [page.number for page in pages] == [1, 3, 5]
    assert pages[0].blocks[0].n_all == 95
