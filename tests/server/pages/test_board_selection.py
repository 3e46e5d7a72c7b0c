"""Which rows are shown, in which order."""

from typing import Any

import pytest
from tests.server.pages.invented_board import PROTOCOL

from exceptiondrive_records.db.errors import InvalidRecord
from exceptiondrive_schemas.board import Board
from exceptiondrive_server.boards.query import BoardQuery
from exceptiondrive_server.boards.selection import selected_board, sort_entries
from exceptiondrive_server.boards.table import BoardTable, board_table


@pytest.mark.parametrize("sort", ["accuracy", "nonsense", "family.nowhere", "team"])
def test_only_what_a_board_has_sorts_it(lively_board: Board, sort: str) -> None:
    with pytest.raises(InvalidRecord) as refused:
        sort_entries(lively_board, lively_board.entries, sort)
    assert "one of hcc, ur" in refused.value.fields["sort"]


def test_a_board_is_kept_in_the_order_of_its_ranks(lively_board: Board) -> None:
    assert selected_board(lively_board, BoardQuery(sort="rank"), {}) is lively_board
    turned = selected_board(lively_board, BoardQuery(sort="-rank"), {})
    ranks = [entry.rank for entry in turned.entries]
    assert ranks[:7] == [6, 5, 4, 3, 2, 1, None]


def table_of(board: Board, **query: Any) -> BoardTable:
    return board_table(board, PROTOCOL, BoardQuery(**query))


def names(board: Board, **query: Any) -> list[list[str]]:
    page = table_of(board, **query)
    return [[row.entry.method for row in block.rows] for block in page.blocks]


def test_blocks_are_never_mixed_whatever_the_sort(lively_board: Board) -> None:
    for sort in ("rank", "hcc", "ur", "method", "date", "family.lane_blockage"):
        for sign in ("", "-"):
            page = table_of(lively_board, sort=sign + sort)
            assert [block.source for block in page.blocks] == ["scored", "reference", "reported"]
            for block in page.blocks:
                assert {row.entry.source for row in block.rows} == {block.source}


def test_by_default_ranks_rise_and_unranked_rows_stand_last(lively_board: Board) -> None:
    page = table_of(lively_board)
    assert [row.entry.rank for row in page.blocks[0].rows] == [1, 2, 3, 4, 5, 6, None]


@pytest.mark.parametrize("sign", ["", "-"])
@pytest.mark.parametrize("sort", ["ur", "hcc", "cts", "family.road_surface_hazard"])
def test_a_row_without_the_value_stands_last_in_either_direction(
    lively_board: Board, sort: str, sign: str
) -> None:
    assert names(lively_board, sort=sign + sort)[0][-1] == "half-a-file"


def test_a_minus_sorts_descending(lively_board: Board) -> None:
    assert names(lively_board, sort="ur")[0][0] == "Kestrel-2"
    assert names(lively_board, sort="-ur")[0][0] == "nerve"
    assert names(lively_board, sort="-hcc")[2][0] == "ST-P3"


def test_filters_match_method_and_team_whatever_the_case(lively_board: Board) -> None:
    assert names(lively_board, search="HALDEN") == [["Kestrel-2", "nerve"]]
    assert names(lively_board, search="halden kes") == [["Kestrel-2"]]
    of_references = names(lively_board, source="reference", sort="rank")
    assert of_references == [["FREEZE", "CONSTANT VELOCITY"]]
    assert names(lively_board, search="nobody") == []


def test_long_boards_are_cut_into_pages(lively_board: Board) -> None:
    entry = lively_board.entries[0]
    many = tuple(
        entry.model_copy(update={"rank": n + 1, "submission_id": f"s{n}"}) for n in range(95)
    )
    board = lively_board.model_copy(update={"entries": many})
    pages = [table_of(board, page=number) for number in (1, 3, 99)]
    assert [len(page.blocks[0].rows) for page in pages] == [20, 20, 15]
    assert [page.number for page in pages] == [1, 3, 5]
    assert pages[0].blocks[0].n_all == 95
