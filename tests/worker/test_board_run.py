"""Boards from real records: ranks, intervals, marks, and what two builds have in common."""

from collections.abc import Callable, Mapping
from typing import Any

import pytest
from tests.support import documents
from tests.support.worker import build_board_of

from exceptiondrive_records.boards.tables import BoardRow
from exceptiondrive_records.submissions.edits import edit_submission
from exceptiondrive_records.submissions.submissions import withdraw
from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.method_facts import SubmissionChange
from exceptiondrive_schemas.split import Split
from exceptiondrive_worker.splits.private_store import Shelf

World = Any
MakeFile = Callable[..., bytes]


def build(world: World) -> Board:
    """Want a board, build it, and return the current one, without the references made for it."""
    board: Board = world.build_board()
    rows = tuple(row for row in board.entries if row.submission_id or row.source == "reported")
    return board.model_copy(update={"entries": rows})


def n_boards(world: World) -> int:
    with world.database.read() as session:
        return int(session.query(BoardRow).count())


def row_of(board: Board, method: str) -> BoardEntry:
    (row,) = [row for row in board.entries if row.method == method]
    return row


def rename(world: World, submission_id: str, method: str) -> None:
    with world.database.write() as session:
        edit_submission(session, submission_id, SubmissionChange(method=method), actor="team:1")


def test_entries_rank_by_hcc_and_ties_share_a_rank(
    phase: World, tiny: Split, planning_file: MakeFile
) -> None:
    for method, speed in {"best": 1.0, "twin": 1.0, "last": 4.0, "middle": 2.0}.items():
        phase.score(planning_file(tiny, edited_mps=speed), method=method, team=method)
    board = build(phase)
    assert [(row.method, row.rank) for row in board.entries] == [
        ("best", 1),
        ("twin", 1),
        ("middle", 3),
        ("last", 4),
    ]
    assert board.headline == "macro_family"
    assert board.n_samples == 4
    assert [(head.id, head.n) for head in board.families] == [
        ("sudden_emergence", 1),
        ("lane_blockage", 2),
        ("road_surface_hazard", 1),
    ]


def test_a_row_says_what_its_team_says_of_the_entry(
    phase: World, tiny: Split, planning_file: MakeFile
) -> None:
    submission_id = phase.score(planning_file(tiny), method="one", team="alpha")
    said = {
        "description": "It brakes.",
        "paper_url": "https://example.org/paper",
        "code_url": "https://example.org/code",
    }
    with phase.database.write() as session:
        edit_submission(
            session, submission_id, SubmissionChange.model_validate(said), actor="team:1"
        )
    (row,) = build(phase).entries
    assert (row.submission_id, row.method, row.team) == (submission_id, "one", "Alpha")
    assert row.submitted_at == phase.submission(submission_id).received_at
    assert (row.description, row.links.paper, row.links.code) == tuple(said.values())


def test_rank_intervals_hold_the_rank_and_intervals_the_value(
    world: World, even: Split, planning_file: MakeFile
) -> None:
    world.add_phase(even)
    for method, speed in {"one": 1.8, "two": 2.0, "three": 4.0}.items():
        world.score(planning_file(even, edited_mps=speed), method=method)
    for row in build(world).entries:
        assert row.rank is not None
        assert row.rank_interval is not None
        assert row.rank_interval[0] <= row.rank <= row.rank_interval[1]
        for key, interval in row.intervals.items():
            assert interval is not None
            low, high = interval
            assert low <= (row.metrics[key] or 0) <= high


def test_of_a_withheld_split_rank_intervals_tell_no_more_than_the_intervals_that_are_told(
    world: World, make_split: Callable[..., Split], planning_file: MakeFile
) -> None:
    """The attack: companions beside a probe, whose exact draws say which of both is the better."""
    tasks = ("SE1", "SE3") * 4
    split = make_split(
        {f"s-{i}": {"task": t, "scene_id": f"scene-{i}"} for i, t in enumerate(tasks)}
    )
    world.add_phase(split)
    for method, speed in {"probe": 1.8, "companion": 1.9}.items():
        world.score(planning_file(split, edited_mps=speed), method=method)
    better, worse = build(world).entries
    assert (better.rank, worse.rank) == (1, 2)
    assert better.intervals["hcc"] is not None
    assert worse.intervals["hcc"] is not None
    assert better.intervals["hcc"][0] <= worse.intervals["hcc"][1], "they overlap"
    assert better.rank_interval == worse.rank_interval == (1, 2)


def test_everything_on_a_board_is_rounded(
    phase: World, tiny: Split, planning_file: MakeFile
) -> None:
    phase.score(planning_file(tiny, edited_mps=2.13))
    (row,) = build(phase).entries
    values = [*row.metrics.values(), *(v for cell in row.families.values()
              for v in cell.metrics.values())]  # fmt: skip
    ends = [end for interval in row.intervals.values() if interval for end in interval]
    ends += [end for cell in row.families.values()
             for interval in cell.intervals.values() if interval for end in interval]  # fmt: skip
    assert ends
    assert all(value == round(value, 4) for value in (*values, *ends) if value is not None)


def test_low_coverage_never_ranks_and_says_why(
    world: World, even: Split, planning_file: MakeFile
) -> None:
    world.add_phase(even)
    world.score(planning_file(even), method="complete")
    world.score(planning_file(even, changes={"SE1": {"source": None}}), method="gaps")
    board = build(world)
    row = row_of(board, "gaps")
    assert row.rank is None
    assert row.rank_interval is None
    assert row.unranked_because == "83.33% of the original scenes are answered; a rank needs 99%"
    assert row.metrics["hcc"] == 1.0
    assert row_of(board, "complete").rank_interval == (1, 1)


def test_an_entry_without_a_defined_rank_metric_is_last_and_unranked(
    phase: World, tiny: Split, planning_file: MakeFile
) -> None:
    nothing = {key: {"source": None, "edited": None} for key in "abcd"}
    phase.score(planning_file(tiny, changes=nothing), method="silent")
    phase.score(planning_file(tiny, edited_mps=4.0), method="bad")
    board = build(phase)
    assert [row.method for row in board.entries] == ["bad", "silent"]
    assert row_of(board, "silent").rank is None
    assert row_of(board, "silent").metrics["cts"] is None
    assert row_of(board, "silent").intervals["cts"] is None


def test_reference_entries_are_marked_and_do_not_rank(
    world: World, even: Split, planning_file: MakeFile
) -> None:
    world.add_phase(even)
    world.score(planning_file(even, edited_mps=0.0, source_mps=0.0), method="STILL",
                team="reference-team")  # fmt: skip
    world.score(planning_file(even, edited_mps=2.0), method="planner")
    board = build(world)
    assert [(row.method, row.source, row.rank) for row in board.entries] == [
        ("planner", "scored", 1),
        ("STILL", "reference", None),
    ]
    assert row_of(board, "planner").rank_interval == (1, 1)
    assert "source_stands_still" in [flag.code for flag in row_of(board, "STILL").flags]


def test_reported_rows_come_last_and_only_where_the_phase_shows_them(
    world: World, even: Split, planning_file: MakeFile
) -> None:
    world.add_phase(even, shows_reported=True)
    world.score(planning_file(even, edited_mps=2.0), method="planner")
    board = build(world)
    assert [row.source for row in board.entries] == ["scored", *["reported"] * 7]
    assert row_of(board, "ST-P3").metrics["hcc"] == 0.2103
    assert all(row.rank is None for row in board.entries if row.source == "reported")
    assert row_of(board, "planner").rank_interval == (1, 1)


def test_the_latest_submission_of_a_method_is_its_entry(
    phase: World, tiny: Split, planning_file: MakeFile
) -> None:
    phase.score(planning_file(tiny, edited_mps=4.0), method="m")
    newest = phase.score(planning_file(tiny, edited_mps=2.0), method="m")
    (row,) = build(phase).entries
    assert row.submission_id == newest


def test_building_again_without_news_publishes_nothing(
    phase: World, tiny: Split, planning_file: MakeFile
) -> None:
    phase.score(planning_file(tiny), method="one")
    first = build(phase)
    phase.score(planning_file(tiny, edited_mps=2.0), method="two", team="beta")
    second = build(phase)
    assert n_boards(phase) == 2
    assert build(phase) == second
    assert n_boards(phase) == 2
    assert second.board == first.board + 1


def test_previous_ranks_come_from_the_board_before(
    phase: World, tiny: Split, planning_file: MakeFile
) -> None:
    phase.score(planning_file(tiny, edited_mps=2.2), method="old")
    assert build(phase).entries[0].previous_rank is None
    phase.score(planning_file(tiny, edited_mps=1.0), method="new")
    board = build(phase)
    assert (row_of(board, "old").rank, row_of(board, "old").previous_rank) == (2, 1)
    assert (row_of(board, "new").rank, row_of(board, "new").previous_rank) == (1, None)


def test_methods_that_exchange_their_names_move_no_rank(
    phase: World, tiny: Split, planning_file: MakeFile
) -> None:
    better = phase.score(planning_file(tiny, edited_mps=1.0), method="one")
    worse = phase.score(planning_file(tiny, edited_mps=2.2), method="two")
    build(phase)
    rename(phase, better, "free")
    rename(phase, worse, "one")
    rename(phase, better, "two")
    assert [(row.method, row.rank, row.previous_rank) for row in build(phase).entries] == [
        ("two", 1, 1),
        ("one", 2, 2),
    ]


def test_a_new_method_does_not_come_from_where_one_stands_that_had_its_name(
    phase: World, tiny: Split, planning_file: MakeFile
) -> None:
    stays = phase.score(planning_file(tiny, edited_mps=2.2), method="m")
    build(phase)
    rename(phase, stays, "other")
    phase.score(planning_file(tiny, edited_mps=1.0), method="m")
    assert [(row.method, row.previous_rank) for row in build(phase).entries] == [
        ("m", None),
        ("other", 1),
    ]


def test_the_next_run_of_a_method_comes_from_where_the_one_before_stood(
    phase: World, tiny: Split, planning_file: MakeFile
) -> None:
    phase.score(planning_file(tiny, edited_mps=1.0), method="first")
    phase.score(planning_file(tiny, edited_mps=2.2), method="m")
    build(phase)
    phase.score(planning_file(tiny, edited_mps=0.5), method="m")
    row = row_of(build(phase), "m")
    assert (row.rank, row.previous_rank) == (1, 2)


def test_a_withdrawn_entry_leaves_the_board(
    phase: World, tiny: Split, planning_file: MakeFile
) -> None:
    gone = phase.score(planning_file(tiny), method="gone")
    phase.score(planning_file(tiny, edited_mps=2.0), method="stays")
    build(phase)
    with phase.database.write() as session:
        withdraw(session, gone, actor="test")
    assert [row.method for row in build(phase).entries] == ["stays"]


def test_the_first_board_of_a_phase_is_empty(phase: World) -> None:
    board = build(phase)
    assert board.entries == ()
    assert board.board == 1


def test_nothing_is_built_when_nothing_is_wanted(phase: World) -> None:
    build(phase)
    build_board_of(phase.context, "dev", phase.protocol_digest())
    assert n_boards(phase) == 1


def test_without_its_split_a_board_is_not_built_but_stays_wanted(
    phase: World, tiny: Split, planning_file: MakeFile, capsys: pytest.CaptureFixture[str]
) -> None:
    phase.score(planning_file(tiny))
    (phase.settings.splits_dir / "tiny" / "split.json").rename(phase.settings.splits_dir / "away")
    phase.reopen_context()
    build_board_of(phase.context, "dev", phase.protocol_digest())
    assert n_boards(phase) == 0
    log = capsys.readouterr().out
    assert "split unavailable: board not built" in log
    assert "job=board:dev" in log
    assert "code=split_unavailable" in log


def test_a_lost_private_store_changes_no_board(
    phase: World, tiny: Split, planning_file: MakeFile
) -> None:
    for speed in (1.9, 2.0, 3.0):
        phase.score(planning_file(tiny, edited_mps=speed), method=f"m{speed}")
    before = build(phase)
    for shelf in Shelf:
        for path in (phase.context.private.root / shelf).iterdir():
            path.unlink()
    assert build(phase).entries == before.entries
    assert n_boards(phase) == 1


def test_a_new_entry_costs_only_its_own_intervals(
    phase: World, tiny: Split, planning_file: MakeFile
) -> None:
    for speed in (1.9, 2.0, 3.0):
        phase.score(planning_file(tiny, edited_mps=speed), method=f"m{speed}")
    build(phase)
    intervals = phase.context.private.root / Shelf.INTERVALS
    written = {path.name: path.stat().st_mtime_ns for path in intervals.iterdir()}
    assert len(written) == 4, "three entries and FREEZE"
    phase.score(planning_file(tiny, edited_mps=2.5), method="new")
    build(phase)
    now = {path.name: path.stat().st_mtime_ns for path in intervals.iterdir()}
    assert len(now) == 5
    assert {name: now[name] for name in written} == written


def strategy_file(split: Split, strategies: Mapping[str, str | None]) -> bytes:
    return documents.strategy_file(strategies, split.name)


def test_the_strategy_challenge_runs_through_the_same_code(world: World, tiny: Split) -> None:
    world.add_phase(tiny, challenge="strategy", shows_reported=True)
    # SE1 takes C or D, LB1 takes C, RS1 takes C or E
    right = {"a": "D", "b": "C", "c": "C", "d": "E"}
    world.score(strategy_file(tiny, right), method="right")
    world.score(strategy_file(tiny, right | {"a": "A"}), method="bold")
    world.score(strategy_file(tiny, right | {"a": None}), method="silent")
    board = build(world)
    assert board.challenge == "strategy"
    assert [(row.method, row.rank) for row in board.entries] == [
        ("right", 1),
        ("bold", 2),
        ("silent", None),
        ("Qwen2.5VL-7B", None),
        ("Qwen2.5VL-7B + Reminder", None),
    ]
    bold = row_of(board, "bold")
    assert bold.micro == {
        "accuracy": 0.75,
        "under_warning": 0.25,
        "over_warning": 0.0,
        "missing": 0.0,
    }
    assert bold.metrics["accuracy"] == 0.6667
    assert row_of(board, "silent").unranked_because == (
        "75.00% of the samples are answered; a rank needs 99%"
    )
