"""Which entries a board lists without a rank: by their flags, by their coverage, for want of scenes."""

from collections.abc import Callable
from typing import Any

import pytest
from tests.support import documents

from exceptiondrive_records.protocols.protocols import add_protocol
from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.protocol import packaged_protocol_toml
from exceptiondrive_schemas.split import Split

World = Any
MakeFile = Callable[..., bytes]
N = 200


@pytest.fixture(scope="module")
def wide(make_split: Callable[..., Split]) -> Split:
    """Two hundred samples in twenty scenes, all of one task."""
    return make_split(
        {f"s-{i:03d}": {"task": "LB1", "scene_id": f"scene-{i % 20}"} for i in range(N)}, "wide"
    )


@pytest.fixture(scope="module")
def planning_file() -> MakeFile:
    """Everybody drives straight ahead, in no two samples equally fast."""

    def make(
        split: Split, edited_mps: float = 1.0, source_mps: float = 4.0, changes: Any = None
    ) -> bytes:
        speeds_mps = {
            sample.sample_id: edited_mps * (1 + number / 4000)
            for number, sample in enumerate(split.samples)
        }
        return documents.planning_file(
            speeds_mps, source_mps=source_mps, changes=changes, split=split.name
        )

    return make


@pytest.fixture
def open_phase(world: World) -> Callable[..., World]:
    """Open the phase `dev` on a split, under a packaged protocol, changed as told."""

    def opened(split: Split, version: str, **options: Any) -> World:
        with world.database.write() as session:
            add_protocol(session, packaged_protocol_toml(version), "test")
        world.add_phase(split, protocol=version, **options)
        return world

    return opened


def teams(board: Board) -> list[BoardEntry]:
    return [row for row in board.entries if row.source == "scored"]


def submit_all(world: World, split: Split, planning_file: MakeFile) -> None:
    """A parked car, one that creeps, one that brakes late and one that brakes in time."""
    world.score(planning_file(split, edited_mps=0.0), method="parked")
    world.score(planning_file(split, edited_mps=0.25), method="creeping")
    world.score(planning_file(split, edited_mps=2.5), method="late", team="beta")
    world.score(planning_file(split, edited_mps=1.5), method="in time")


def test_a_parked_car_ranks_first_under_1_0_and_leads_nothing(
    open_phase: Callable[..., World], wide: Split, planning_file: MakeFile
) -> None:
    world = open_phase(wide, "1.0")
    submit_all(world, wide, planning_file)
    board = world.build_board()
    rows = {row.method: row for row in teams(board)}
    assert [rows[name].rank for name in ("parked", "creeping", "in time", "late")] == [1, 1, 1, 4]
    assert "stands_still" in {flag.code for flag in rows["parked"].flags}
    assert all(row.unranked_flags == () for row in rows.values())
    assert not rows["parked"].may_lead
    assert board.leader is not None
    assert board.leader.method == "in time"


def test_under_1_1_flagged_entries_are_listed_below_in_the_order_that_they_would_have(
    open_phase: Callable[..., World], wide: Split, planning_file: MakeFile
) -> None:
    world = open_phase(wide, "1.1")
    submit_all(world, wide, planning_file)
    world.score(planning_file(wide, edited_mps=0.1, source_mps=0.1), method="never leaves")
    gaps = {f"s-{i:03d}": {"edited": None} for i in range(10)}
    world.score(planning_file(wide, edited_mps=1.5, changes=gaps), method="gaps")
    board = world.build_board()
    assert [(row.method, row.rank) for row in teams(board)] == [
        ("in time", 1),
        ("late", 2),
        ("parked", None),
        ("creeping", None),
        ("never leaves", None),
        ("gaps", None),
    ]
    rows = {row.method: row for row in teams(board)}
    assert rows["parked"].unranked_flags == ("stands_still", "impossible_motion", "hardly_moves")
    assert rows["parked"].unranked_because == (
        "flagged Stands still, Impossible motion and Hardly moves; protocol 1.1 ranks no such entry"
    )
    assert rows["parked"].metrics["hcc"] == 1.0, "the numbers stay"
    assert rows["parked"].intervals["hcc"] is not None
    assert rows["in time"].rank_interval == (1, 1)
    assert rows["late"].rank_interval == (2, 2), "of two ranked entries, not of six"
    assert board.leader is not None
    assert board.leader.method == "in time"
    assert "a rank needs 99%" in (rows["gaps"].unranked_because or "")


def test_zeros_in_place_of_missing_answers_rank_no_better_than_these(
    open_phase: Callable[..., World], wide: Split, planning_file: MakeFile
) -> None:
    world = open_phase(wide, "1.1")
    for n_filled, is_ranked in ((2, True), (3, False)):
        names = [f"s-{i:03d}" for i in range(n_filled)]
        nulls = {name: {"edited": None} for name in names}
        zeros = {name: {"edited": [[0.0, 0.0]] * 6} for name in names}
        for word, changes in (("nulls", nulls), ("zeros", zeros)):
            file = planning_file(wide, edited_mps=1.5, changes=changes)
            world.score(file, method=f"{n_filled} {word}")
        rows = {row.method: row for row in teams(world.build_board())}
        assert (rows[f"{n_filled} nulls"].rank is not None) == is_ranked
        assert (rows[f"{n_filled} zeros"].rank is not None) == is_ranked


def test_coverage_is_judged_by_the_exact_share(
    open_phase: Callable[..., World],
    make_split: Callable[..., Split],
    planning_file: MakeFile,
) -> None:
    """Three of 299 are missing: 98.9967 % are left, which reads 99.00 %."""
    odd = make_split({f"s-{i:03d}": {"scene_id": f"scene-{i % 9}"} for i in range(299)})
    world = open_phase(odd, "1.0")
    for n_missing in (2, 3):
        gaps = {f"s-{i:03d}": {"edited": None} for i in range(n_missing)}
        world.score(planning_file(odd, changes=gaps), method=str(n_missing))
    rows = {row.method: row for row in teams(world.build_board())}
    assert rows["3"].coverage["edited"] == 0.99
    assert rows["2"].rank == 1
    assert rows["3"].rank is None
    assert "98.997%" in (rows["3"].unranked_because or "")


@pytest.mark.parametrize(("version", "n_scenes", "is_told"), [
    ("1.0", 1, True), ("1.0", 2, False), ("1.1", 4, True), ("1.1", 5, False),
])  # fmt: skip
def test_too_few_scenes_have_no_interval_and_the_board_says_so(
    open_phase: Callable[..., World],
    make_split: Callable[..., Split],
    planning_file: MakeFile,
    version: str,
    n_scenes: int,
    is_told: bool,
) -> None:
    few = make_split({f"s-{i}": {"scene_id": f"scene-{i % n_scenes}"} for i in range(10)})
    world = open_phase(few, version)
    world.score(planning_file(few, edited_mps=2.5), method="late", team="beta")
    world.score(planning_file(few, edited_mps=1.5), method="in time")
    board = world.build_board()
    ranked = [row for row in teams(board) if row.rank is not None]
    assert [row.rank for row in ranked] == [1, 2]
    assert (board.min_scenes is not None) == is_told
    for row in ranked:
        assert (row.rank_interval is None) == is_told
        assert (row.intervals["hcc"] is None) == is_told
        assert all((cell.intervals["hcc"] is None) == is_told for cell in row.families.values())
    (pair,) = board.comparisons
    assert (pair.overall["hcc"].interval is None) == is_told


def test_a_family_of_too_few_scenes_leaves_the_board_without_ranges_and_is_named(
    open_phase: Callable[..., World], make_split: Callable[..., Split], planning_file: MakeFile
) -> None:
    of_many = {f"m-{i}": {"scene_id": f"scene-{i}"} for i in range(10)}
    of_few = {f"f-{i}": {"task": "LB1", "scene_id": f"scene-{i % 4}"} for i in range(8)}
    split = make_split(of_many | of_few)
    world = open_phase(split, "1.1")
    world.score(planning_file(split, edited_mps=1.5))
    board = world.build_board()
    (row,) = (row for row in teams(board) if row.rank is not None)
    assert (row.rank_interval, row.intervals["hcc"], board.min_scenes) == (None, None, 5)
    has_interval = {key: cell.intervals["hcc"] is not None for key, cell in row.families.items()}
    assert has_interval == {"sudden_emergence": True, "lane_blockage": False}
    assert [(head.id, head.n, head.n_scenes) for head in board.families] == [
        ("sudden_emergence", 10, None),
        ("lane_blockage", 8, 4),
    ]


def test_the_same_answer_everywhere_is_flagged_and_unranked_in_1_1(
    open_phase: Callable[..., World], wide: Split
) -> None:
    world = open_phase(wide, "1.1", challenge="strategy")
    letters = {sample.sample_id: "C" for sample in wide.samples}
    world.score(documents.strategy_file(letters, split=wide.name), method="stopping")
    mixed = letters | {f"s-{i:03d}": "D" for i in range(10)}
    world.score(documents.strategy_file(mixed, split=wide.name), method="nearly always")
    rows = {row.method: row for row in teams(world.build_board())}
    assert rows["stopping"].metrics["accuracy"] == 1.0
    assert rows["stopping"].unranked_flags == ("same_answer",)
    assert rows["nearly always"].rank == 1
