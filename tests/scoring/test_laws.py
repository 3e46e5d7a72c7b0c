"""Laws that hold for every input (docs/protocol.md sections 8 and 9)."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_scoring.aliases import FloatArray
from exceptiondrive_scoring.arrays import SplitArrays, TrajectoryPairs
from exceptiondrive_scoring.grade import SampleScores, grade, progress_of_pairs
from exceptiondrive_scoring.measure import measure
from exceptiondrive_scoring.planning import clearance_curve
from exceptiondrive_scoring.sheet import aggregate

MakeSplit = Callable[..., SplitArrays]
TOLERANCE = 1e-9

centimetres = st.integers(-3000, 3000).map(lambda value: value / 100)
waypoint = st.tuples(st.integers(-1500, 1500), st.integers(-1500, 1500))
on_grid = st.lists(waypoint, min_size=6, max_size=6).map(lambda points: np.array(points) / 100)
straight_on_grid = st.tuples(st.integers(0, 300), st.integers(0, 50)).map(
    lambda step: np.cumsum(np.tile(np.array(step) / 100, (6, 1)), axis=0)
)
trajectory = st.one_of(on_grid, straight_on_grid, st.none())


@st.composite
def region(draw: st.DrawFn) -> FloatArray:
    """A quadrilateral that is star-shaped about its centre, the fifth row: maybe concave."""
    centre = np.array([draw(centimetres), draw(centimetres)])
    quadrants = np.arange(4) * np.pi / 2
    angle = quadrants + np.array([draw(st.floats(0.1, 1.4)) for _ in range(4)])
    radius = np.array([draw(st.floats(0.3, 8.0)) for _ in range(4)])
    corners = centre + np.stack([np.cos(angle), np.sin(angle)], -1) * radius[:, None]
    return np.concatenate([corners, centre[None]])


@dataclass(frozen=True)
class Board:
    source: list[FloatArray | None]
    edited: list[FloatArray | None]
    regions: FloatArray
    centres: FloatArray
    tasks: list[int]

    @property
    def pairs(self) -> TrajectoryPairs:
        return TrajectoryPairs.from_columns(
            {"source": _stack(self.source), "edited": _stack(self.edited)}
        )


def _stack(trajectories: list[FloatArray | None]) -> FloatArray:
    return np.stack([np.full((6, 2), np.nan) if t is None else t for t in trajectories])


@st.composite
def board(draw: st.DrawFn) -> Board:
    n = draw(st.integers(1, 5))
    shapes = [draw(region()) for _ in range(n)]
    return Board(
        source=[draw(trajectory) for _ in range(n)],
        edited=[draw(trajectory) for _ in range(n)],
        regions=np.stack([shape[:4] for shape in shapes]),
        centres=np.stack([shape[4] for shape in shapes]),
        tasks=[draw(st.integers(0, 20)) for _ in range(n)],
    )


@pytest.fixture(scope="module")
def score(protocol: ProtocolDocument, make_split: MakeSplit) -> Callable[..., SampleScores]:
    def score(case: Board, *, d_safe_scale: float = 1.0) -> SampleScores:
        grading = protocol.grading.model_copy(update={"d_safe_scale": d_safe_scale})
        chosen = protocol.model_copy(update={"grading": grading})
        split = make_split(case.regions, tasks=case.tasks)
        return grade(measure(case.pairs, split.regions_m, protocol.geometry), split, chosen)

    return score


Score = Callable[..., SampleScores]
laws = settings(max_examples=60, deadline=None)


def close(a: FloatArray, b: FloatArray) -> None:
    np.testing.assert_allclose(a, b, rtol=0, atol=TOLERANCE, equal_nan=True)


@laws
@given(case=board())
def test_fractions_lie_between_zero_and_one(case: Board, score: Score) -> None:
    fractions = score(case).values[:, :3]
    assert ((fractions >= 0) & (fractions <= 1)).all()


@laws
@given(case=board())
def test_hcc_and_hpr_are_bounded_by_what_is_safe(
    case: Board, score: Score, protocol: ProtocolDocument, make_split: MakeSplit
) -> None:
    scores = score(case)
    split = make_split(case.regions, tasks=case.tasks)
    sheet = aggregate(scores, split, protocol.taxonomy)
    rows = [sheet.micro, sheet.macro_family, *sheet.families.values()]
    for row in rows:
        hcc, ur, hpr = (row[key] or 0.0 for key in ("hcc", "ur", "hpr"))
        assert hcc <= 1 - ur + TOLERANCE
        assert hpr <= (hcc + 1 - ur) / 2 + TOLERANCE


@laws
@given(case=board())
def test_the_shift_lies_between_its_components(case: Board, score: Score) -> None:
    cts, cts_x, cts_y = score(case).values[:, 3:6].T
    defined = ~np.isnan(cts)
    assert (np.hypot(cts_x, cts_y) <= cts + TOLERANCE)[defined].all()
    assert (cts <= cts_x + cts_y + TOLERANCE)[defined].all()


@laws
@given(case=board(), seed=st.integers(0, 1000))
def test_the_order_of_samples_and_corners_changes_nothing(
    case: Board, seed: int, score: Score
) -> None:
    rng = np.random.default_rng(seed)
    order = rng.permutation(len(case.tasks))
    turned = np.roll(case.regions, int(rng.integers(4)), axis=1)[:, :: int(rng.choice([-1, 1]))]
    shuffled = Board(
        source=[case.source[i] for i in order],
        edited=[case.edited[i] for i in order],
        regions=turned[order],
        centres=case.centres[order],
        tasks=[case.tasks[i] for i in order],
    )
    close(score(shuffled).values, score(case).values[order])


@laws
@given(case=board())
def test_mirroring_y_changes_nothing(case: Board, score: Score) -> None:
    def mirror(trajectory: FloatArray | None) -> FloatArray | None:
        return None if trajectory is None else trajectory * [1.0, -1.0]

    mirrored = Board(
        source=[mirror(t) for t in case.source],
        edited=[mirror(t) for t in case.edited],
        regions=case.regions * [1.0, -1.0],
        centres=case.centres * [1.0, -1.0],
        tasks=case.tasks,
    )
    close(score(mirrored).values, score(case).values)


@laws
@given(case=board())
def test_edited_equal_to_source_has_no_shift(case: Board, score: Score) -> None:
    same = Board(case.edited, case.edited, case.regions, case.centres, case.tasks)
    shift = score(same).values[:, 3:6]
    given_rows = np.array([t is not None for t in case.edited])
    assert (shift[given_rows] == 0).all()
    assert np.isnan(shift[~given_rows]).all()


@laws
@given(case=board(), growth=st.floats(1.0, 3.0))
def test_a_larger_region_never_raises_the_clearance(
    case: Board, growth: float, protocol: ProtocolDocument
) -> None:
    centres = case.centres[:, None]
    larger = centres + growth * (case.regions - centres)
    before = measure(case.pairs, case.regions, protocol.geometry).clearance_m
    after = measure(case.pairs, larger, protocol.geometry).clearance_m
    assert (~(after > before + TOLERANCE)).all()


@laws
@given(case=board(), scale=st.floats(1.0, 10.0))
def test_more_required_clearance_never_raises_hcc(case: Board, scale: float, score: Score) -> None:
    assert (score(case, d_safe_scale=scale).values[:, 0] <= score(case).values[:, 0]).all()


@laws
@given(case=board())
def test_a_missing_edited_trajectory_is_unsafe_and_stays_counted(case: Board, score: Score) -> None:
    values = score(case).values
    missing = np.array([t is None for t in case.edited])
    assert (values[missing][:, :3] == [0.0, 1.0, 0.0]).all()
    undefined = missing | np.array([t is None for t in case.source])
    np.testing.assert_array_equal(np.isnan(values[:, 3]), undefined)
    assert not np.isnan(values[:, :3]).any()


def column(scores: SampleScores, key: str) -> FloatArray:
    return scores.values[:, scores.metric_keys.index(key)]


OUTCOMES = ("clear", "close", "hit_reacting", "hit_unmoved")


@laws
@given(case=board())
def test_every_sample_has_one_outcome(case: Board, score: Score) -> None:
    scores = score(case)
    outcomes = np.stack([column(scores, key) for key in OUTCOMES])
    assert (outcomes.sum(axis=0) == 1).all()
    np.testing.assert_array_equal(outcomes[2] + outcomes[3], column(scores, "ur"))
    np.testing.assert_array_equal(outcomes[0] == 1, column(scores, "hcc") == 1)


@laws
@given(case=board())
def test_progress_is_a_share_of_a_source_path_that_is_long_enough(
    case: Board, score: Score, protocol: ProtocolDocument
) -> None:
    progress = column(score(case), "progress")
    paths = [None if path is None else np.insert(path, 0, 0.0, axis=0) for path in case.source]
    lengths = [0.0 if path is None else np.hypot(*np.diff(path, axis=0).T).sum() for path in paths]
    is_long = np.array(lengths) >= protocol.plausibility.progress_min_path_m
    np.testing.assert_array_equal(np.isnan(progress), ~is_long)
    assert ((progress[is_long] >= 0) & (progress[is_long] <= 1)).all()
    missing = np.array([path is None for path in case.edited])
    assert (progress[is_long & missing] == 0).all()


@laws
@given(case=board(), away_m=st.floats(-50, 50))
def test_where_the_regions_lie_changes_neither_progress_nor_source_fit(
    case: Board, away_m: float, protocol: ProtocolDocument
) -> None:
    geometry, recorded = protocol.geometry, _stack(case.edited)
    one = measure(case.pairs, case.regions, geometry, recorded).columns()
    other = measure(case.pairs, case.regions + away_m, geometry, recorded).columns()
    for name in ("reached_m", "source_path_m", "source_l2_m", "source_l2_2s_m"):
        np.testing.assert_array_equal(one[name], other[name])


@given(speed=st.floats(1, 20), share=st.floats(0, 1), aside=st.floats(-3, 3), turn=st.floats(-3, 3))
def test_on_a_straight_source_path_progress_is_the_way_along_it(
    speed: float, share: float, aside: float, turn: float, protocol: ProtocolDocument
) -> None:
    turned = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])

    def progress(end: tuple[float, float]) -> float:
        source = np.arange(1, 7)[:, None] * np.array([speed / 2, 0.0])
        edited = np.linspace(0, 1, 7)[1:, None] * np.array(end)
        columns = {"source": (source @ turned)[None], "edited": (edited @ turned)[None]}
        pairs = TrajectoryPairs.from_columns(columns)
        return float(progress_of_pairs(pairs, protocol.plausibility)[0])

    length_m = 3 * speed
    assert progress((share * length_m, aside)) == pytest.approx(share, abs=1e-9)
    assert progress((-share * length_m, aside)) == pytest.approx(0.0, abs=1e-9), "backing"
    assert progress((0.0, aside)) == pytest.approx(0.0, abs=1e-9), "sideways"


@laws
@given(case=board())
def test_the_clearance_curve_holds_ur_the_share_clear_and_hcc(
    case: Board, protocol: ProtocolDocument, make_split: MakeSplit
) -> None:
    split = make_split(case.regions, tasks=case.tasks)
    measured = measure(case.pairs, split.regions_m, protocol.geometry)
    curve = clearance_curve(measured, split, protocol)
    sheet = aggregate(grade(measured, split, protocol), split, protocol.taxonomy)
    for points, row in ((curve.micro, sheet.micro), (curve.macro_family, sheet.macro_family)):
        assert points[0] == pytest.approx(1 - (row["ur"] or 0.0), abs=TOLERANCE)
        assert points[10] == pytest.approx(row["clear"], abs=TOLERANCE)
        assert list(points) == sorted(points, reverse=True)
        area = curve.step * (sum(points[:11]) - (points[0] + points[10]) / 2)
        most = curve.step / 2 * (row["close"] or 0.0)
        assert abs(area - (row["hcc"] or 0.0)) <= most + TOLERANCE
