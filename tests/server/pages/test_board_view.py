"""The board as a page shows it."""

from dataclasses import replace
from typing import Any

import pytest
from tests.server.pages.invented_board import BLIND, KEYS, STILL
from tests.server.pages.reading import read

from exceptiondrive_schemas.board import Board, FamilyCell
from exceptiondrive_schemas.challenges import PLANNING, STRATEGY, Challenge
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_server.boards.entry_facts import why_no_intervals
from exceptiondrive_server.boards.families import Hardness, families_of
from exceptiondrive_server.boards.queries import without_reported
from exceptiondrive_server.boards.query import BY_RANK, BoardQuery
from exceptiondrive_server.boards.table import BoardTable, board_table, metric_columns, short_title
from exceptiondrive_server.web.templating import macro


def view(board: Board, protocol: ProtocolDocument, **query: Any) -> BoardTable:
    return board_table(without_reported(board), protocol, BoardQuery(**{"sort": BY_RANK, **query}))


def test_the_columns_of_a_planning_board() -> None:
    columns = [column.key for column in metric_columns(PLANNING, BoardQuery())]
    assert columns == [metric.key for metric in PLANNING.columns]
    assert tuple(columns[: len(KEYS)]) == KEYS
    assert not {"progress", "clear", "source_l2_m"}.intersection(columns)


@pytest.mark.parametrize(("challenge", "with_letters"), [(PLANNING, {"CTS"}), (STRATEGY, set())])
def test_what_stands_small_behind_a_label_is_the_component_of_cts(
    challenge: Challenge, with_letters: set[str]
) -> None:
    columns = metric_columns(challenge, BoardQuery())
    labels = [challenge.metric(column.key).label for column in columns]
    assert [f"{column.label}{column.subscript}" for column in columns] == labels
    assert {column.label for column in columns if column.subscript} == with_letters


@pytest.mark.parametrize(
    ("query", "said"),
    [
        ({}, ""),
        ({"source": "reference"}, "2 planners of 9 found."),
        ({"search": "kestrel"}, "1 planner of 9 found for \u201ckestrel\u201d."),
    ],
)
def test_a_search_says_how_many_it_finds(
    lively_board: Board, protocol: ProtocolDocument, query: dict[str, str], said: str
) -> None:
    assert view(lively_board, protocol, **query).found_sentence == said


def test_the_outcome_bar_draws_shares_of_samples_one_beside_the_other(
    lively_board: Board, protocol: ProtocolDocument
) -> None:
    rows = [row for block in view(lively_board, protocol).blocks for row in block.rows]
    bars = [row.outcome for row in rows if row.outcome]
    assert len(bars) == 8
    for bar in bars:
        assert [kind for kind, _, _ in bar.parts] == ["kept", "lost", "hit", "unmoved"]
        ends = [start + width for _, start, width in bar.parts]
        assert [start for _, start, _ in bar.parts] == [0, *ends[:-1]]
        assert ends[-1] == pytest.approx(100)
    shares = [lively_board.entries[0].metrics[part.metric] for part in PLANNING.words.outcome]
    assert [width for _, _, width in bars[0].parts] == [100 * (share or 0) for share in shares]


def test_a_row_of_a_scorer_that_counted_no_outcomes_has_no_bar(
    lively_board: Board, protocol: ProtocolDocument
) -> None:
    first = lively_board.entries[0]
    older = first.model_copy(update={"metrics": {key: first.metrics[key] for key in KEYS}})
    board = lively_board.model_copy(update={"entries": (older,)})
    assert view(board, protocol).blocks[0].rows[0].outcome is None


def test_only_scored_rows_carry_a_rank_and_a_best_mark(
    lively_board: Board, protocol: ProtocolDocument
) -> None:
    for block in view(lively_board, protocol).blocks:
        for row in block.rows:
            assert (row.rank is not None) <= (block.source == "scored")
            assert any(cell.is_best for cell in row.cells) <= (block.source == "scored")


def test_a_range_of_one_rank_says_on_what_it_rests(
    lively_board: Board, protocol: ProtocolDocument
) -> None:
    first = lively_board.entries[0].model_copy(update={"rank_interval": (1, 1)})
    changes = {"entries": (first, *lively_board.entries[1:]), "confidence": 0.9}
    rows = view(lively_board.model_copy(update=changes), protocol).blocks[0].rows
    assert rows[0].rank_words == "rank 1; certain at 90\u202f%"
    assert rows[1].rank_words == "rank 2; it could be any from 1 to 3"


def test_a_row_without_a_score_says_why_it_is_not_ranked(
    lively_board: Board, protocol: ProtocolDocument
) -> None:
    row = view(lively_board, protocol).blocks[0].rows[-1]
    assert row.rank is None
    assert row.rank_words == "62.00% of the samples as edited are answered; a rank needs 99%"
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


def test_the_rows_that_could_be_first_are_those_whose_rank_range_holds_1(
    lively_board: Board, protocol: ProtocolDocument
) -> None:
    seen = view(lively_board, protocol)
    marked = [row.entry.rank_interval for row in seen.rows if row.key in seen.first_of_all]
    assert marked == [(1, 2), (1, 3)]
    assert seen.first_sentence == "Marked at the left: the 2 that could be first."


@pytest.mark.parametrize(
    ("headline", "n_scenes", "takes"),
    [
        ("macro_family", 1, "10 in each family, and Sudden Emergence has 1"),
        ("macro_family", None, "10 in each family"),
        ("micro", 1, "10"),
    ],
)
def test_a_board_without_intervals_names_the_family_of_too_few_scenes(
    lively_board: Board, headline: str, n_scenes: int | None, takes: str
) -> None:
    first, *others = lively_board.families
    heads = (first.model_copy(update={"n_scenes": n_scenes}), *others)
    told = {"headline": headline, "min_scenes": 10, "families": heads}
    said = why_no_intervals(lively_board.model_copy(update=told))
    few = "This split has too few scenes to say how sure a number is"
    assert said == f"{few}: intervals take {takes}."


def test_the_other_average_shows_its_values_without_intervals(
    lively_board: Board, protocol: ProtocolDocument
) -> None:
    seen = view(lively_board, protocol, average="micro")
    first = seen.blocks[0].rows[0]
    assert first.cells[0].text == "60.70"
    assert first.cells[0].whisker is not None
    assert first.cells[0].whisker.low is None
    assert first.rank == "1"


def test_primary_columns_cannot_be_hidden(lively_board: Board, protocol: ProtocolDocument) -> None:
    seen = view(lively_board, protocol, hidden=frozenset({"hcc", "hpr"}))
    shown = [column.key for column in seen.columns]
    assert shown == [metric.key for metric in PLANNING.columns if metric.key != "hpr"]


def test_progress_is_a_column_for_who_asks_for_it(
    lively_board: Board, protocol: ProtocolDocument
) -> None:
    keys = [metric.key for metric in PLANNING.columns]
    assert [column.key for column in view(lively_board, protocol).columns] == keys
    seen = view(lively_board, protocol, added=frozenset({"progress", "clear"}))
    assert [column.key for column in seen.columns] == [*keys, "progress"]
    assert seen.rows[0].cells[-1].text == "62.00"
    assert seen.extra_columns == [("progress", "Progress"), ("date", "Date of submission")]


def test_what_a_flag_bars_from_leading_is_never_marked_as_the_best(
    lively_board: Board, protocol: ProtocolDocument
) -> None:
    first, second, *others = lively_board.entries
    parked = first.model_copy(update={"flags": (STILL,)})
    seen = view(lively_board.model_copy(update={"entries": (parked, second, *others)}), protocol)
    cells = [[cell.is_best for cell in row.cells[:2]] for row in seen.rows[:2]]
    assert cells == [[False, False], [True, True]]
    assert not any(tile.is_best for tile in seen.rows[0].tiles)


def test_listed_entries_stand_below_the_ranked_ones_whatever_the_sort(
    lively_board: Board, protocol: ProtocolDocument
) -> None:
    first, *others = lively_board.entries
    changes = {"rank": None, "rank_interval": None, "unranked_flags": ("stands_still",)}
    listed = first.model_copy(update={**changes, "unranked_because": "it stands still"})
    board = lively_board.model_copy(update={"entries": (*others[:6], listed, *others[6:])})
    for sort in ("rank", "-hcc", "ur", "method"):
        rows = view(board, protocol, sort=sort).blocks[0].rows
        assert [row.entry.rank is None for row in rows] == [False] * 5 + [True] * 2
        (words,) = (row.rank_words for row in rows[-2:] if row.entry is listed)
        assert words == "it stands still"


def test_a_row_without_a_rank_says_in_words_what_it_lacks(
    lively_board: Board, protocol: ProtocolDocument
) -> None:
    (half,) = (entry for entry in lively_board.entries if entry.method == "half-a-file")
    table = view(lively_board, protocol)
    assert table.heading("scored", True)[0] == "Listed without a rank"
    assert table.heading("scored", False) == ("", "")
    assert table.lacks(half) == "62.00 % answered"
    still = half.model_copy(update={"flags": (STILL, BLIND), "unranked_flags": (STILL.code,)})
    assert table.lacks(still) == "Stands still, 62.00 % answered"
    covered = still.model_copy(update={"coverage": {"edited": 0.99}})
    assert table.lacks(covered) == "Stands still"
    unknown = half.model_copy(update={"coverage": {}, "unranked_because": "HCC not defined"})
    assert table.lacks(unknown) == "HCC not defined"


def test_tasks_that_are_not_told_are_counted(
    lively_board: Board, protocol: ProtocolDocument
) -> None:
    table = view(lively_board, protocol)
    tasks = tuple(Hardness(task.id, task.title, 12, 0.5, 0.6, 6) for task in protocol.tasks)

    def said(told: tuple[Hardness, ...], least: int) -> str:
        publication = protocol.publication.model_copy(update={"min_samples_per_cell": least})
        section = macro("boards/families.html", "families_section")(
            table=table,
            shown=families_of(lively_board),
            plot=None,
            tasks=told,
            protocol=protocol.model_copy(update={"publication": publication}),
        )
        return " ".join(str(section).split())

    assert "6 of 21 tasks, with fewer than 10 samples, are not told." in said(tasks[:15], 10)
    assert "1 of 21 tasks, with no sample, are not told." in said(tasks[1:], 1)
    assert "not told" not in said(tasks, 10)


@pytest.mark.parametrize(
    ("n_large", "sentence"),
    [(6, "easiest, by"), (2, "easiest of those with at least 30 samples, by"), (1, ""), (0, "")],
)
def test_no_family_of_few_samples_is_called_hardest_or_easiest(
    lively_board: Board, protocol: ProtocolDocument, n_large: int, sentence: str
) -> None:
    heads = tuple(
        head.model_copy(update={"n": 30 if at < n_large else 29})
        for at, head in enumerate(lively_board.families)
    )
    board = lively_board.model_copy(update={"families": heads})
    shown = families_of(board)
    assert {line.n for line in shown.large} <= {30}
    assert sentence in shown.sentence
    assert bool(shown.sentence) == bool(sentence)
    section = macro("boards/families.html", "families_section")(
        table=view(board, protocol), shown=shown, plot=None, tasks=(), protocol=protocol
    )
    assert str(section).count('<i class="star">hardest</i>') == (n_large > 1)


def test_a_family_without_a_mean_is_said_to_be_none_of_those_called_hardest(
    lively_board: Board,
) -> None:
    assert "told" not in families_of(lively_board).sentence
    untold = lively_board.families[0].id
    entries = tuple(
        entry.model_copy(
            update={
                "families": {key: cell for key, cell in entry.families.items() if key != untold}
            }
        )
        for entry in lively_board.entries
    )
    shown = families_of(lively_board.model_copy(update={"entries": entries}))
    assert shown.sentence.endswith(" by the mean of all 6 ranked. 1 of 6 families is not told.")


def test_exactly_one_column_is_marked_as_sorted_and_clicking_it_turns_it_round() -> None:
    columns = metric_columns(PLANNING, BoardQuery(sort="ur"))
    assert [column.aria_sort for column in columns].count(None) == len(columns) - 1
    ur = next(column for column in columns if column.key == "ur")
    assert (ur.aria_sort, ur.sort_words) == ("ascending", "sorted, best first")
    assert ur.sort_url == "/?sort=-ur#s-ur"


@pytest.mark.parametrize(
    ("sort", "said"),
    [
        (BY_RANK, "Sorted by rank: HCC, then UR."),
        ("-ur", "UR sorted, worst first; ranks stay as they are."),
        ("-family.lane_blockage", "Sorted by one family; ranks stay as they are."),
        ("-date", "Sorted by date; ranks stay as they are."),
    ],
)
def test_a_board_says_by_what_it_is_sorted(
    lively_board: Board, protocol: ProtocolDocument, sort: str, said: str
) -> None:
    assert view(lively_board, protocol, sort=sort).sort_sentence == said


def test_rows_by_rank_stand_in_the_order_of_the_protocol(
    lively_board: Board, protocol: ProtocolDocument
) -> None:
    order = tuple(reversed(protocol.ranking.order_of(PLANNING)))
    ranking = protocol.ranking.model_copy(update={"order": {"planning": order}})
    table = view(lively_board, protocol.model_copy(update={"ranking": ranking}))
    assert table.sort_sentence == "Sorted by rank: UR, then HCC."
    assert [(c.key, c.aria_sort) for c in table.columns if c.aria_sort] == [("ur", "ascending")]
    row = macro("boards/table.html", "board_row")(table.rows[0], table, False)
    assert [key for key in KEYS if f"{key} by" in row] == ["ur"], "it leads the row of a phone"


def test_under_the_other_average_no_column_stands_in_the_order_of_the_ranks(
    lively_board: Board, protocol: ProtocolDocument
) -> None:
    table = view(lively_board, protocol, average="micro")
    assert table.sort_sentence == "Sorted by rank of the mean of families: HCC, then UR."
    assert not [column.key for column in table.columns if column.aria_sort]


@pytest.mark.parametrize(
    ("number", "n_pages", "numbers"),
    [
        (1, 1, [1]),
        (2, 4, [1, 2, 3, 4]),
        (5, 9, [1, None, 3, 4, 5, 6, 7, None, 9]),
        (9, 9, [1, None, 7, 8, 9]),
    ],
)
def test_pages_that_are_not_named_are_one_gap(
    lively_board: Board, protocol: ProtocolDocument, number: int, n_pages: int, numbers: list[Any]
) -> None:
    table = replace(view(lively_board, protocol), number=number, n_pages=n_pages)
    assert table.page_numbers == numbers


def test_an_untouched_board_is_marked_as_sorted_by_the_metric_that_ranks(
    lively_board: Board, protocol: ProtocolDocument
) -> None:
    columns = view(lively_board, protocol).columns
    assert [(c.key, c.aria_sort) for c in columns if c.aria_sort] == [("hcc", "descending")]


@pytest.mark.parametrize(
    ("title", "short"),
    [
        ("Bypass and Gap Conflict", "Bypass and gap"),
        ("Intersection Conflict", "Intersection"),
        ("Lane Blockage", "Lane blockage"),
        ("Road-Surface Hazard", "Road-surface"),
    ],
)
def test_a_narrow_column_has_a_short_title(title: str, short: str) -> None:
    assert short_title(title) == short


def test_small_families_are_marked_with_their_size(
    lively_board: Board, protocol: ProtocolDocument
) -> None:
    tiles = view(lively_board, protocol).blocks[0].rows[0].tiles
    assert [tile.is_small for tile in tiles] == [False, False, False, True, True, False]
    assert "n = 14" in tiles[3].words


def test_a_reference_off_the_axis_is_not_drawn_at_its_end(
    lively_board: Board, protocol: ProtocolDocument
) -> None:
    low = [e for e in lively_board.entries if e.method in ("nerve", "FREEZE")]
    rows = view(lively_board.model_copy(update={"entries": tuple(low)}), protocol).rows
    drawn = {row.entry.method: row.cells[0].whisker is not None for row in rows}
    assert drawn == {"nerve": True, "FREEZE": False}


def test_the_head_of_the_first_column_tells_where_its_lines_begin_and_end(
    lively_board: Board, protocol: ProtocolDocument
) -> None:
    """Of all scored entries; references alone stand on the whole of it."""
    for source, ends in (("scored", ("0", "80")), ("reference", ("0", "100")), ("none", None)):
        entries = tuple(one for one in lively_board.entries if one.source == source)
        table = view(lively_board.model_copy(update={"entries": entries}), protocol)
        head = read(str(macro("boards/table.html", "table_head")(table)))
        told = [text.text for svg in head.all("svg", "wk") for text in svg.all("text")]
        assert told == list(ends or ())


def test_a_planner_without_a_rank_does_not_wash_out_the_colours_of_the_others(
    lively_board: Board, protocol: ProtocolDocument
) -> None:
    safest = lively_board.entries[0]
    cells = {
        name: FamilyCell.model_validate({"n": cell.n, "hcc": 0.99})
        for name, cell in safest.families.items()
    }
    brake = safest.model_copy(update={"submission_id": "brake", "rank": None, "families": cells})
    usual = view(lively_board, protocol)
    entries = (*lively_board.entries, brake)
    beside = view(lively_board.model_copy(update={"entries": entries}), protocol)
    assert beside.builder.heat_top == usual.builder.heat_top < 0.99
    assert {tile.step for row in beside.rows if row.key == "brake" for tile in row.tiles} == {9}
    alone = view(lively_board.model_copy(update={"entries": (brake,)}), protocol)
    assert alone.builder.heat_top == 1.0


def test_where_only_reference_rows_stand_a_poor_one_is_not_as_dark_as_the_best(
    lively_board: Board, protocol: ProtocolDocument
) -> None:
    yardsticks = tuple(one for one in lively_board.entries if one.source == "reference")
    rows = view(lively_board.model_copy(update={"entries": yardsticks}), protocol).rows
    steps = {row.entry.method: {tile.step or 0 for tile in row.tiles} for row in rows}
    assert min(steps["FREEZE"]) > 6
    assert max(steps["CONSTANT VELOCITY"]) < 3
