"""Which rows are shown, in which order."""

from typing import Any

import pytest
from tests.server.pages.invented_board import PROTOCOL

from exceptiondrive_records.db.errors import InvalidRecord
from exceptiondrive_schemas.board import Board
from exceptiondrive_schemas.method_facts import EntryFacts, MethodFacts
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


def test_by_rank_page_and_files_list_what_has_none_in_the_order_of_the_board(
    lively_board: Board,
) -> None:
    """That is the protocol's: flagged ones before those that answer too little, the oldest first."""
    bare = [
        lively_board.entries[at].model_copy(update={"rank": None, "rank_interval": None})
        for at in (4, 0, 2)
    ]
    kept = (*lively_board.entries[5:6], *bare, *lively_board.entries[6:])
    board = lively_board.model_copy(update={"entries": kept})
    in_order = [entry.method for entry in kept]
    assert [row.entry.method for row in table_of(board).rows] == in_order
    assert [entry.method for entry in selected_board(board, BoardQuery(), {}).entries] == in_order
    hcc = [entry.metrics["hcc"] or 0.0 for entry in bare]
    assert hcc != sorted(hcc, reverse=True)


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
    assert pages[0].n_found == 95


FACTS = {
    "s0000000kq": EntryFacts(facts=MethodFacts(type="vla", sensors=("lidar",), open_code="yes")),
    "s0000001kq": EntryFacts(facts=MethodFacts(type="rule", sensors=("lidar", "radar"))),
    "s0000004kq": EntryFacts(facts=MethodFacts(type="vla", open_code="no")),
}


@pytest.mark.parametrize(
    ("facts", "found"),
    [
        ("type:vla", ["Kestrel-2", "VLA-7B zero-shot"]),
        ("type:vla,open_code:yes", ["Kestrel-2"]),
        ("type:vla,type:rule,sensors:radar", ["LaneKeeper XL (bypass head, 3 s)"]),
        ("map:hd", []),
    ],
)
def test_facts_filter_page_and_files_alike(
    lively_board: Board, facts: str, found: list[str]
) -> None:
    """Of one field any value that is asked for, of several fields each."""
    query = BoardQuery.parse([("fact", facts)])
    table = board_table(lively_board, PROTOCOL, query, facts=FACTS)
    assert [row.entry.method for row in table.rows] == found
    assert [e.method for e in selected_board(lively_board, query, FACTS).entries] == found
    assert BoardQuery.parse(query.pairs()) == query


def test_chips_count_what_is_told_and_turn_the_filter(lively_board: Board) -> None:
    query = BoardQuery.parse([("fact", "type:vla")])
    table = board_table(lively_board, PROTOCOL, query, facts=FACTS)
    chips = {chip.title: chip for title, each in table.fact_choices for chip in each}
    assert {title: chip.n for title, chip in chips.items()} == {
        "VLA": 2, "Rule-based": 1, "Lidar": 2, "Radar": 1, "Open code": 1, "Closed code": 1,
    }  # fmt: skip
    assert (chips["VLA"].is_on, chips["VLA"].url) == (True, "/#board")
    assert chips["Lidar"].url == "/?fact=sensors:lidar,type:vla#board"


def test_what_is_no_fact_is_refused() -> None:
    with pytest.raises(InvalidRecord) as refused:
        BoardQuery.parse([("fact", "type:car")])
    assert "FIELD:VALUE" in refused.value.fields["fact"]
