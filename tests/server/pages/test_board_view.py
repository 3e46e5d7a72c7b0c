"""The board as a page shows it."""

from typing import Any

from tests.server.pages.invented_board import KEYS

from exceptiondrive_schemas.board import Board
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_server.boards.query import BoardQuery
from exceptiondrive_server.boards.table import BoardTable, board_table, metric_columns


def view(board: Board, protocol: ProtocolDocument, **query: Any) -> BoardTable:
    return board_table(board, protocol, BoardQuery(**query))


def test_the_columns_of_a_planning_board() -> None:
    columns = [column.key for column in metric_columns(PLANNING, BoardQuery())]
    assert columns == ["hcc", "ur", "hpr", "cts", "cts_x", "cts_y"]


def test_outcome_bars_add_up_to_the_whole(lively_board: Board, protocol: ProtocolDocument) -> None:
    for block in view(lively_board, protocol).blocks:
        for row in block.rows:
            if row.outcome:
                assert abs(row.outcome.kept + row.outcome.lost + row.outcome.hit - 100) < 1e-6


def test_the_papers_rows_are_shown_digit_for_digit(
    paper_board: Board, protocol: ProtocolDocument
) -> None:
    rows = {row.entry.method: row for row in view(paper_board, protocol).blocks[0].rows}
    printed = ("21.03", "78.11", "18.59", "1.57", "1.55", "0.24")
    by_key = dict(zip(KEYS, printed, strict=True))
    shown = [cell.text for cell in rows["ST-P3"].cells]
    assert shown == [by_key.get(key) for key in PLANNING.metric_keys]
    families = [tile.text for tile in rows["AutoVLA"].tiles]
    assert families == ["9.90", "12.86", "10.22", "9.78", "9.92", "9.56"]
    assert rows["VAD"].tiles == ()


def test_only_scored_rows_carry_a_rank_and_a_best_mark(
    lively_board: Board, protocol: ProtocolDocument
) -> None:
    for block in view(lively_board, protocol).blocks:
        for row in block.rows:
            assert (row.rank is not None) <= (block.source == "scored")
            assert any(cell.is_best for cell in row.cells) <= (block.source == "scored")


def test_a_row_without_a_score_says_why_it_is_not_ranked(
    lively_board: Board, protocol: ProtocolDocument
) -> None:
    row = view(lively_board, protocol).blocks[0].rows[-1]
    assert row.rank is None
    assert row.rank_words == "coverage 0.62 is below 0.99"
    assert all(cell.text is None for cell in row.cells)


def test_movement_is_told_in_words(lively_board: Board, protocol: ProtocolDocument) -> None:
    rows = view(lively_board, protocol).blocks[0].rows
    words = [row.movement.words if row.movement else None for row in rows]
    assert words[:4] == [
        "up 2 since the last board",
        "down 1 since the last board",
        "new on this board",
        None,
    ]


def test_the_leaders_nearer_end_is_the_dotted_line(
    lively_board: Board, protocol: ProtocolDocument
) -> None:
    seen = view(lively_board, protocol)
    leader = seen.blocks[0].rows[0]
    hcc, ur = leader.cells[0].whisker, leader.cells[1].whisker
    assert hcc is not None
    assert ur is not None
    assert ur.low is not None
    assert ur.width is not None
    assert seen.builder.leader_line("hcc") == hcc.low
    end = seen.builder.leader_line("ur")
    assert end is not None
    assert abs(end - (ur.low + ur.width)) < 1e-9


def test_the_other_average_shows_its_values_without_intervals(
    lively_board: Board, protocol: ProtocolDocument
) -> None:
    seen = view(lively_board, protocol, average="micro")
    first = seen.blocks[0].rows[0]
    assert first.cells[0].text == "60.70"
    assert first.cells[0].whisker is not None
    assert first.cells[0].whisker.low is None
    assert first.rank == "1"
    reported = seen.blocks[-1].rows[0]
    assert reported.cells[0].text is None


def test_primary_columns_cannot_be_hidden(lively_board: Board, protocol: ProtocolDocument) -> None:
    seen = view(lively_board, protocol, hidden=frozenset({"hcc", "hpr"}))
    shown = [column.key for column in seen.columns]
    assert shown == [key for key in PLANNING.metric_keys if key != "hpr"]


def test_exactly_one_column_is_marked_as_sorted_and_clicking_it_turns_it_round() -> None:
    columns = metric_columns(PLANNING, BoardQuery(sort="ur"))
    assert [column.aria_sort for column in columns].count(None) == len(columns) - 1
    ur = next(column for column in columns if column.key == "ur")
    assert (ur.aria_sort, ur.sort_words) == ("ascending", "sorted, best first")
    assert ur.sort_url == "/?sort=-ur#board"


def test_an_untouched_board_is_marked_as_sorted_by_the_metric_that_ranks() -> None:
    columns = metric_columns(PLANNING, BoardQuery())
    assert [(c.key, c.aria_sort) for c in columns if c.aria_sort] == [("hcc", "descending")]


def test_small_families_are_marked_with_their_size(
    lively_board: Board, protocol: ProtocolDocument
) -> None:
    tiles = view(lively_board, protocol).blocks[0].rows[0].tiles
    assert [tile.is_small for tile in tiles] == [False, False, False, True, True, False]
    assert "n = 14" in tiles[3].words
