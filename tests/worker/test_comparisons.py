"""Every two of the best entries on a board, compared sample by sample."""

from collections.abc import Callable
from itertools import combinations
from typing import Any

import pytest
from billiard.exceptions import SoftTimeLimitExceeded
from sqlalchemy import select

from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.protocols.protocols import add_protocol
from exceptiondrive_records.splits.splits import publish_split
from exceptiondrive_records.submissions.tables import ScoreSheetRow
from exceptiondrive_schemas.base import bytes_digest
from exceptiondrive_schemas.board import Board, PairedComparison
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.protocol import packaged_protocol, packaged_protocol_toml
from exceptiondrive_schemas.published import example_text
from exceptiondrive_schemas.score_sheet import BreakdownRow, PairedDifference, ScoreSheet
from exceptiondrive_schemas.split import Split
from exceptiondrive_scoring import bootstrap
from exceptiondrive_scoring.bootstrap import SceneSums
from exceptiondrive_worker.boards.comparisons import published_comparison
from exceptiondrive_worker.boards.rounding import Rounding
from exceptiondrive_worker.splits.private_store import Shelf
from exceptiondrive_worker.stages import Stages, Target

World = Any
MakeFile = Callable[..., bytes]
SPEEDS = {"best": 1.0, "twin": 1.0, "middle": 2.0, "last": 4.0}


@pytest.fixture(scope="module")
def tiny(even: Split) -> Split:
    """What `phase` has here: with intervals."""
    return even


def by_method(board: Board) -> dict[tuple[str, str], PairedComparison]:
    method = {entry.submission_id: entry.method for entry in board.entries}
    return {(method[pair.a], method[pair.b]): pair for pair in board.comparisons}


@pytest.fixture
def board(phase: World, tiny: Split, planning_file: MakeFile) -> Board:
    for method, speed in SPEEDS.items():
        phase.score(planning_file(tiny, edited_mps=speed), method=method, team=method)
    built: Board = phase.build_board()
    return built


def test_a_build_that_is_ended_in_its_middle_keeps_the_intervals_that_it_has(
    phase: World, tiny: Split, planning_file: MakeFile, monkeypatch: pytest.MonkeyPatch
) -> None:
    for method, speed in SPEEDS.items():
        phase.score(planning_file(tiny, edited_mps=speed), method=method, team=method)
    monkeypatch.setattr(bootstrap, "BLOCK_DRAWS", 1)
    stages, asked = phase.context.stages, []

    def ended_at_the_third(target: Target, key: str) -> SceneSums:
        asked.append(key)
        if len(asked) == 3:
            raise SoftTimeLimitExceeded
        return Stages.scene_sums(stages, target, key)

    monkeypatch.setattr(stages, "scene_sums", ended_at_the_third)
    with pytest.raises(SoftTimeLimitExceeded):
        phase.build_board()
    kept = phase.context.private.root / Shelf.INTERVALS.value
    assert len(list(kept.iterdir())) == 2


def test_each_ranked_entry_is_compared_with_each_the_better_ranked_first(board: Board) -> None:
    assert list(by_method(board)) == list(combinations(("best", "twin", "middle", "last"), 2))


def test_a_difference_is_the_difference_of_what_the_board_shows(board: Board) -> None:
    entry = {row.method: row for row in board.entries}
    for (a, b), pair in by_method(board).items():
        for key in ("hcc", "ur"):
            shown = (entry[a].metrics[key] or 0) - (entry[b].metrics[key] or 0)
            assert pair.overall[key].difference == pytest.approx(shown, abs=1.01e-4)
        for family, found in pair.families.items():
            cells = [entry[name].families[family].metrics["hcc"] or 0 for name in (a, b)]
            assert found.difference == pytest.approx(cells[0] - cells[1], abs=1.01e-4)


def test_the_same_answers_differ_nowhere_and_cannot_be_told_apart(board: Board) -> None:
    same = by_method(board)["best", "twin"]
    assert {each.difference for each in same.overall.values()} <= {0.0, None}
    assert same.overall["hcc"].discordant is None, "how many differ is withheld"
    assert same.overall["hcc"].verdict == "not separable on this split"


def test_a_verdict_names_the_method_and_follows_from_the_interval(board: Board) -> None:
    for (a, b), pair in by_method(board).items():
        found = pair.overall["hcc"]
        if found.interval is None:
            assert found.verdict == "no interval"
        elif found.interval[0] <= 0 <= found.interval[1]:
            assert found.verdict == "not separable on this split"
        else:
            assert found.verdict == f"{a if found.interval[0] > 0 else b} is better"


def test_only_digits_that_the_protocol_publishes_leave(board: Board) -> None:
    for pair in board.comparisons:
        for found in (*pair.overall.values(), *pair.families.values()):
            assert found.difference is None or found.difference == round(found.difference, 4)
        for key in ("hcc", "ur", "hpr"):
            assert all(end == round(end, 2) for end in pair.overall[key].interval or ())


def test_a_new_entry_repeats_no_comparison(
    phase: World, tiny: Split, planning_file: MakeFile, board: Board
) -> None:
    folder = phase.context.private.root / Shelf.COMPARISONS
    kept = {path: path.stat().st_mtime_ns for path in folder.rglob("*") if path.is_file()}
    assert len(kept) == 4, "the two files with the same answers share theirs"
    phase.score(planning_file(tiny, edited_mps=3.0), method="new", team="new")
    assert len(phase.build_board().comparisons) == 10
    assert all(path.stat().st_mtime_ns == at for path, at in kept.items())


def test_the_protocol_says_how_many_are_compared(
    world: World, tiny: Split, planning_file: MakeFile
) -> None:
    toml = packaged_protocol_toml().replace("compared_entries = 10", "compared_entries = 2")
    with world.database.write() as session:
        add_protocol(session, toml.replace('version = "1.0"', 'version = "1.0.1"'), "test")
    world.add_phase(tiny, protocol="1.0.1")
    for method, speed in SPEEDS.items():
        world.score(planning_file(tiny, edited_mps=speed), method=method, team=method)
    assert list(by_method(world.build_board())) == [("best", "twin")]


def sheets(world: World) -> dict[str, ScoreSheet]:
    with world.database.read() as session:
        rows = session.scalars(select(ScoreSheetRow))
        return {row.submission_id: row.sheet for row in rows}


def test_tasks_say_no_more_than_the_two_published_cells(phase: World, board: Board) -> None:
    sheet = sheets(phase)
    assert board.comparisons
    for pair in board.comparisons:
        assert set(pair.tasks) == set(sheet[pair.a].tasks)
        for task, found in pair.tasks.items():
            a, b = (sheet[name].tasks[task].metrics["hcc"] or 0.0 for name in (pair.a, pair.b))
            assert found.difference == round(a - b, 4)
            assert found.discordant is None
            if found.interval is not None:
                low, high = found.interval
                assert (low, high) == (round(low, 2), round(high, 2))
                assert low <= found.difference <= high
                if low <= 0 <= high:
                    assert found.verdict == "not separable on this split"


def test_small_tasks_and_families_are_left_out(
    world: World, tiny: Split, planning_file: MakeFile
) -> None:
    toml = packaged_protocol_toml().replace("min_samples_per_cell = 1", "min_samples_per_cell = 99")
    assert "min_samples_per_cell = 99" in toml
    with world.database.write() as session:
        add_protocol(session, toml.replace('version = "1.0"', 'version = "1.0.1"'), "test")
    world.add_phase(tiny, protocol="1.0.1")
    for method, speed in SPEEDS.items():
        world.score(planning_file(tiny, edited_mps=speed), method=method, team=method)
    for pair in world.build_board().comparisons:
        assert (pair.tasks, pair.families) == ({}, {})
        assert pair.overall["hcc"].difference is not None


PUBLIC = Rounding(PLANNING, packaged_protocol().publication, is_public=True)


def _pair(difference: float, interval: tuple[float, float]) -> PairedComparison:
    one = PairedDifference(
        difference=difference, interval=interval, discordant=0.05, verdict="A is better"
    )
    overall = dict.fromkeys(PLANNING.metric_keys, one)
    return PairedComparison(
        a="a", b="b", overall=overall, families={"lane_blockage": one}, tasks={"LB1": one}
    )


def _sheet(example: ScoreSheet, hcc: float, n_in_cell: int = 20) -> ScoreSheet:
    row = dict.fromkeys(PLANNING.metric_keys, hcc)
    cell = BreakdownRow.of(n_in_cell, dict(row))
    return example.model_copy(
        update={
            "micro": row,
            "macro_family": row,
            "families": {"lane_blockage": cell},
            "tasks": {"LB1": cell},
        }
    )


LEAST = packaged_protocol().publication.min_samples_per_cell


@pytest.mark.parametrize(
    ("of_a", "of_b", "is_told"),
    [(LEAST, LEAST, True), (LEAST, LEAST - 1, False), (LEAST - 1, LEAST, False)],
)
def test_a_cell_is_told_only_where_both_sheets_have_enough_samples_of_it(
    of_a: int, of_b: int, is_told: bool
) -> None:
    example = ScoreSheet.model_validate_json(example_text("score-sheet"))
    shown = (_sheet(example, 0.5, of_a), _sheet(example, 0.25, of_b))
    pair = _pair(0.25, (0.1, 0.4))
    told = published_comparison(pair, PLANNING, packaged_protocol(), shown, PUBLIC)
    assert (bool(told.families), bool(told.tasks)) == (is_told, is_told)


@pytest.mark.parametrize("exact", [0.00335, 0.00345, 0.00349, 0.0031])
def test_no_difference_of_shares_reads_the_exact_values_once_more(exact: float) -> None:
    """Exact means 0.12344 and 0.12005, or 0.12336 and 0.12046: published, they are the same two."""
    example = ScoreSheet.model_validate_json(example_text("score-sheet"))
    shown = (_sheet(example, 0.1234), _sheet(example, 0.12))
    told = published_comparison(
        _pair(exact, (0.0, 0.01)), PLANNING, packaged_protocol(), shown, PUBLIC
    )
    cells = [told.overall[key] for key in ("hcc", "ur", "hpr")]
    cells += [*told.families.values(), *told.tasks.values()]
    assert [cell.difference for cell in cells] == [0.0034] * 5


def test_a_metric_that_may_be_undefined_differs_over_the_samples_that_both_define() -> None:
    """Its difference is of the same samples as the interval beside it, so it lies inside."""
    example = ScoreSheet.model_validate_json(example_text("score-sheet"))
    shown = (_sheet(example, 0.9573), _sheet(example, 0.8718))
    told = published_comparison(
        _pair(0.03514, (0.0196, 0.05)), PLANNING, packaged_protocol(), shown, PUBLIC
    )
    assert (told.overall["progress"].difference, told.overall["cts"].difference) == (0.0351, 0.04)
    assert told.overall["hcc"].difference == 0.0855


def test_a_verdict_is_not_surer_than_the_interval_beside_it() -> None:
    example = ScoreSheet.model_validate_json(example_text("score-sheet"))
    shown = (_sheet(example, 0.1234), _sheet(example, 0.12))
    barely = _pair(0.0034, (0.00004, 0.0071))
    told = published_comparison(barely, PLANNING, packaged_protocol(), shown, PUBLIC)
    assert told.overall["hcc"].interval == (0.0, 0.0071)
    assert told.overall["hcc"].verdict == "not separable on this split"
    sure = _pair(0.0034, (0.0004, 0.0071))
    told = published_comparison(sure, PLANNING, packaged_protocol(), shown, PUBLIC)
    assert told.overall["hcc"].verdict == "A is better"
    assert told.tasks["LB1"].interval == (0.0, 0.01)
    assert told.tasks["LB1"].verdict == "not separable on this split"


def test_of_a_withheld_split_intervals_are_whole_per_cents_and_no_count_is_told() -> None:
    example = ScoreSheet.model_validate_json(example_text("score-sheet"))
    shown = (_sheet(example, 0.1234), _sheet(example, 0.12))
    withheld = Rounding(PLANNING, packaged_protocol().publication)
    pair = _pair(0.0034, (0.0104, 0.0271))
    told = published_comparison(pair, PLANNING, packaged_protocol(), shown, withheld)
    for cell in (told.overall["hcc"], *told.families.values(), *told.tasks.values()):
        assert (cell.interval, cell.discordant) == ((0.01, 0.03), None)
        assert cell.difference == 0.0034
    assert PUBLIC.interval("hcc", (0.0104, 0.0271)) == (0.0104, 0.0271)


def test_two_entries_of_one_team_are_not_compared_on_a_withheld_split(
    world: World, tiny: Split, planning_file: MakeFile
) -> None:
    """Files that differ in one sample would have that sample's value for an interval."""
    world.add_phase(tiny)
    for method, team in (("a", "one"), ("b", "one"), ("c", "two")):
        speed = {"a": 1.0, "b": 2.0, "c": 3.0}[method]
        world.score(planning_file(tiny, edited_mps=speed), method=method, team=team)
    assert set(by_method(world.build_board())) == {("a", "c"), ("b", "c")}
    with world.database.write() as session:
        revision = session.get_one(Phase, "dev").split_revision
        publish_split(session, tiny.name, revision, bytes_digest(b"its file"), "ops")
    assert set(by_method(world.build_board())) == {("a", "b"), ("a", "c"), ("b", "c")}
