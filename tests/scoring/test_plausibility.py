"""Shares and flags of docs/protocol.md section 5."""

from array import array
from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest
from tests.support import realdata

from exceptiondrive_schemas.check.motion import (
    _progress,
    motion_flags,
    undrivable_rows,
    wrong_first_steps,
)
from exceptiondrive_schemas.check.tracks import PairTracks
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.score_sheet import Plausibility
from exceptiondrive_schemas.split import SplitSample
from exceptiondrive_scoring.aliases import FloatArray
from exceptiondrive_scoring.arrays import SplitArrays, TrajectoryPairs, split_arrays
from exceptiondrive_scoring.grade import measured_progress
from exceptiondrive_scoring.kinematics import (
    peak_acceleration_mps2,
    positions,
    steps,
    tightest_turn_m,
)
from exceptiondrive_scoring.measure import measure
from exceptiondrive_scoring.planning import PlanningScoring
from exceptiondrive_scoring.plausibility import _median, impossible_first_step, plausibility

STILL = np.zeros((6, 2))
CRUISE = np.stack([3.0 * np.arange(1, 7), np.zeros(6)], axis=-1)
JUMP = np.stack([[1, 2, 3, 23, 24, 25], np.zeros(6)], axis=-1).astype(float)
HAIRPIN = np.array([[2, 0], [4, 0], [4, 2], [2, 2], [0, 2], [-2, 2]], dtype=float)
MISSING = np.full((6, 2), np.nan)
FAR_AWAY = ((60.0, 60.0), (62.0, 60.0), (62.0, 62.0), (60.0, 62.0))


@pytest.fixture(scope="session")
def real_case(
    read_case: Callable[..., tuple[TrajectoryPairs, SplitArrays]],
) -> Callable[[str, str], tuple[TrajectoryPairs, SplitArrays]]:
    """Read (split, method) of the real planner files, or skip."""

    def read(name: str, method: str) -> tuple[TrajectoryPairs, SplitArrays]:
        realdata.require()
        return read_case(realdata.split_path(name), realdata.file_path(name, method))

    return read


def _judge(
    source: list[FloatArray],
    edited: list[FloatArray],
    protocol: ProtocolDocument,
    recorded: list[tuple[tuple[float, float], ...]] | None = None,
) -> Plausibility:
    pairs = TrajectoryPairs.from_columns({"source": np.stack(source), "edited": np.stack(edited)})
    samples = [
        SplitSample(
            sample_id=f"s-{i:03d}", scene_id="scene", task="LB1", region=FAR_AWAY, recorded=path
        )
        for i, path in enumerate(recorded or [None] * len(source))
    ]
    split = split_arrays(samples, protocol.taxonomy)
    measured = measure(pairs, split.prepared_regions, protocol.geometry, split.recorded_m)
    return plausibility(measured, split, protocol)


def _codes(judged: Plausibility) -> list[str]:
    return [flag.code for flag in judged.flags]


def test_an_ordinary_planner_raises_no_flag(protocol: ProtocolDocument) -> None:
    judged = _judge([CRUISE] * 4, [0.8 * CRUISE] * 4, protocol)
    assert set(judged.shares.values()) == {0.0}
    assert judged.flags == ()


def test_stopping_for_the_edit_far_more_often_than_without_is_flagged(
    protocol: ProtocolDocument,
) -> None:
    judged = _judge([CRUISE] * 4, [STILL, STILL, 0.5 * CRUISE, 0.5 * CRUISE], protocol)
    assert judged.shares["edited_stationary"] == 0.5
    assert _codes(judged) == ["stands_still", "impossible_motion"]
    assert "50%" in judged.flags[0].detail


def test_the_freeze_planner_is_flagged_as_standing_and_blind(protocol: ProtocolDocument) -> None:
    judged = _judge([STILL] * 4, [STILL] * 4, protocol)
    assert _codes(judged) == ["source_stands_still", "blind_to_the_edit"]


def test_source_given_back_as_edited_is_flagged_as_blind(protocol: ProtocolDocument) -> None:
    assert _codes(_judge([CRUISE] * 3, [CRUISE] * 3, protocol)) == ["blind_to_the_edit"]


@pytest.mark.parametrize("trajectory", [JUMP, HAIRPIN], ids=["jump", "hairpin"])
def test_motion_that_no_car_can_do_is_flagged(
    trajectory: FloatArray, protocol: ProtocolDocument
) -> None:
    judged = _judge([CRUISE] * 10, [trajectory] + [0.8 * CRUISE] * 9, protocol)
    assert judged.shares["impossible"] == pytest.approx(0.1)
    assert "impossible_motion" in _codes(judged)


def test_a_missing_trajectory_counts_as_one_that_stands(protocol: ProtocolDocument) -> None:
    missing = _judge([CRUISE] * 4, [MISSING, 0.8 * CRUISE, 0.8 * CRUISE, MISSING], protocol)
    zeros = _judge([CRUISE] * 4, [STILL, 0.8 * CRUISE, 0.8 * CRUISE, STILL], protocol)
    for share in ("edited_stationary", "source_stationary", "edited_behind", "source_behind"):
        assert missing.shares[share] == zeros.shares[share]
    assert set(_codes(missing)) <= set(_codes(zeros))
    assert "are missing or end" in missing.flags[0].detail
    assert "missing" not in zeros.flags[0].detail
    nothing = _judge([MISSING], [MISSING], protocol)
    assert (nothing.shares["blind"], nothing.shares["impossible"]) == (None, None)
    assert _codes(nothing) == ["source_stands_still"]
    path = tuple((float(x), float(y)) for x, y in CRUISE)
    assert _judge([MISSING], [MISSING], protocol, [path]).flags == nothing.flags


def test_acceleration_is_the_change_of_velocity_between_steps(protocol: ProtocolDocument) -> None:
    points = np.array([[[0, 0], [1, 0], [4, 4], [4, 12]]], dtype=float)
    # steps (1, 0) (3, 4) (0, 8) in 0.5 s: the largest change is (-3, 4), 5 / 0.25
    assert peak_acceleration_mps2(steps(positions(points)), protocol.geometry) == pytest.approx(
        20.0
    )


def test_the_tightest_turn_is_the_circle_through_three_points(protocol: ProtocolDocument) -> None:
    angle = np.linspace(0, 1, 7)
    circle = 8.0 * np.stack([np.sin(angle), 1 - np.cos(angle)], axis=-1)[None]
    assert tightest_turn_m(steps(positions(circle)), protocol.geometry) == pytest.approx(8.0)
    assert np.isinf(tightest_turn_m(steps(positions(CRUISE[None])), protocol.geometry)).all()
    jitter = np.array([[[0, 0], [0.05, 0], [0.05, 0.05], [0, 0.05]]])
    assert np.isinf(tightest_turn_m(steps(positions(jitter)), protocol.geometry)).all()


def test_real_planners_are_not_called_impossible(
    real_case: Callable[[str, str], tuple[TrajectoryPairs, SplitArrays]], protocol: ProtocolDocument
) -> None:
    pairs, split = real_case("nuscenes-real", "recorded-human")
    measured = measure(pairs, split.regions_m, protocol.geometry)
    judged = plausibility(measured, split, protocol)
    assert _codes(judged) == ["blind_to_the_edit"]  # its edited drive is its source drive


MOTION = ("impossible_motion", "reverses", "hardly_moves")
BACKING = np.stack([0.2 - 0.2 * np.arange(6), np.zeros(6)], axis=-1)
SLOW_CRUISE = CRUISE / 2


def test_backing_more_often_than_without_the_hazard_is_flagged(protocol: ProtocolDocument) -> None:
    judged = _judge([SLOW_CRUISE] * 10, [BACKING] + [0.8 * SLOW_CRUISE] * 9, protocol)
    assert judged.shares["edited_behind"] == pytest.approx(0.1)
    assert "reverses" in _codes(judged)
    both = _judge([BACKING] + [CRUISE] * 9, [BACKING] + [0.8 * CRUISE] * 9, protocol)
    assert "reverses" not in _codes(both)


@pytest.mark.parametrize(
    ("first_step_m", "is_wrong"),
    [(0.0, True), (0.59, True), (0.61, False), (6.7, False), (6.8, True)],
)
def test_the_first_step_is_one_that_the_speed_of_the_source_allows(
    protocol: ProtocolDocument, first_step_m: float, is_wrong: bool
) -> None:
    """At 6 m/s and 30 m/s^2 the car stands after 36 / 60 = 0.6 m, and gets 3 + 3.75 m at most."""
    edited = first_step_m * np.stack([np.linspace(1, 1.5, 6), np.zeros(6)], axis=-1)
    judged = _judge([CRUISE], [edited], protocol)
    assert judged.shares["first_step"] == float(is_wrong)


def test_a_source_that_may_have_been_standing_forbids_no_stop(protocol: ProtocolDocument) -> None:
    assert _judge([CRUISE * 0.33], [STILL], protocol).shares["first_step"] == 0.0
    assert _judge([CRUISE * 0.34], [STILL], protocol).shares["first_step"] == 1.0


def test_a_few_zeros_in_place_of_missing_answers_are_flagged(protocol: ProtocolDocument) -> None:
    drives = [(0.8 + i / 1000) * CRUISE for i in range(100)]
    assert _codes(_judge([CRUISE] * 100, [STILL] * 1 + drives[1:], protocol)) == []
    assert _codes(_judge([CRUISE] * 100, [STILL] * 2 + drives[2:], protocol)) == [
        "impossible_motion"
    ]


def test_one_path_in_every_edited_scene_is_flagged(protocol: ProtocolDocument) -> None:
    others = [(0.5 + i / 20) * CRUISE for i in range(6)]
    same = _judge([CRUISE] * 100, [0.8 * CRUISE] * 96 + others[:4], protocol)
    assert _codes(same) == ["same_answer"]
    assert _codes(_judge([CRUISE] * 100, [0.8 * CRUISE] * 94 + others, protocol)) == []
    to_the_left = CRUISE[:, ::-1]
    assert "same_answer" in _codes(_judge([CRUISE] * 100, [to_the_left] * 100, protocol))


def test_sources_far_from_the_recorded_drive_are_off_course(protocol: ProtocolDocument) -> None:
    path = tuple((float(x), float(y)) for x, y in CRUISE)
    sources = [CRUISE + np.array([0.0, 5.1])] * 6 + [CRUISE] * 5
    edited = [0.8 * source for source in sources]
    assert _codes(_judge(sources, edited, protocol, [path] * 11)) == ["off_course"]
    half = [CRUISE + np.array([0.0, 100.0])] * 5 + [CRUISE] * 6
    judged = _judge(half, [0.8 * source for source in half], protocol, [path] * 11)
    assert "off_course" not in _codes(judged), "the median does not follow a few wild samples"


def test_a_flag_says_its_share_to_the_decimals_that_show_what_it_is_raised_for(
    protocol: ProtocolDocument,
) -> None:
    (flag,) = _judge([CRUISE] * 5, [0.196 * CRUISE] * 5, protocol).flags[-1:]
    assert flag.detail == (
        "The edited trajectories end 19.6% along the source trajectories; "
        "less than 20% is hardly any way."
    )
    blind = _judge([CRUISE] * 500, [CRUISE] * 476 + [0.8 * CRUISE] * 24, protocol).flags
    assert blind[0].detail == "95.2% of the pairs differ by less than 0.05 m."


def test_hardly_moving_is_flagged_overall_and_in_a_family_of_enough_samples(
    protocol: ProtocolDocument, make_split: Callable[..., SplitArrays]
) -> None:
    def judge(n_stuck: int) -> list[str]:
        edited = [0.05 * CRUISE] * n_stuck + [0.9 * CRUISE] * (100 - n_stuck)
        columns = {"source": np.stack([CRUISE] * 100), "edited": np.stack(edited)}
        split = make_split(
            np.tile(FAR_AWAY, (100, 1, 1)), tasks=[0] * n_stuck + [4] * (100 - n_stuck)
        )
        pairs = TrajectoryPairs.from_columns(columns)
        return _codes(
            plausibility(measure(pairs, split.regions_m, protocol.geometry), split, protocol)
        )

    assert "hardly_moves" not in judge(19), "too few samples to judge a family by"
    assert "hardly_moves" in judge(20)
    assert "hardly_moves" in judge(90)


@pytest.mark.parametrize(
    ("n_held_back", "n_half_way", "n_standing", "codes"),
    [
        (11, 9, 0, ["over_cautious"]),
        (10, 10, 0, []),
        (19, 0, 0, []),
        (20, 0, 0, ["over_cautious"]),
        (6, 5, 9, ["over_cautious"]),
        (5, 6, 9, []),
        (10, 0, 9, []),
    ],
)
def test_who_hardly_gets_on_at_most_of_enough_controls_is_over_cautious(
    protocol: ProtocolDocument,
    n_held_back: int,
    n_half_way: int,
    n_standing: int,
    codes: list[str],
) -> None:
    """Where both trajectories stand there is no progress, but a control of the split."""
    shares = [0.4] * n_held_back + [0.5] * n_half_way + [0.0] * n_standing
    source = np.stack([CRUISE] * (n_held_back + n_half_way) + [0.0 * CRUISE] * n_standing)
    answers = {"source": source, "edited": np.stack([share * CRUISE for share in shares])}
    said = PlanningScoring().of_controls(answers, protocol)
    assert said.metrics == {"over_caution": n_held_back / (n_held_back + n_half_way)}
    assert [flag.code for flag in said.flags] == codes


def test_medians_are_those_of_numpy_to_the_last_bit() -> None:
    rng = np.random.default_rng(1)
    for n in (1, 2, 3, 300, 3181):
        values = rng.normal(0, 10.0 ** rng.integers(-3, 4), (3, n))
        values[:, : n // 3] = np.round(values[:, : n // 3])  # some alike
        assert np.array_equal(_median(values), np.median(values, axis=1))
        assert _median(values[0]) == np.median(values[0])


def _as_checked(pairs: TrajectoryPairs) -> PairTracks:
    def flat(points: FloatArray) -> "array[float] | None":
        return None if np.isnan(points).any() else array("d", points.ravel().tolist())

    rows = zip(pairs.source, pairs.edited, strict=True)
    return PairTracks.of([(flat(source), flat(edited)) for source, edited in rows], 6)


def test_a_check_before_an_upload_judges_each_sample_as_the_scorer_does(
    protocol: ProtocolDocument,
) -> None:
    rng = np.random.default_rng(4)
    lengths_m = rng.choice([0.0, 0.05, 0.4, 2.0, 4.0, 9.0], (2, 400, 6))
    headings = rng.choice([0.0, np.pi], (2, 400, 1)) + rng.normal(0, 0.5, (2, 400, 6)).cumsum(-1)
    source, edited = (
        (lengths_m * [np.cos(headings), np.sin(headings)]).cumsum(-1).transpose(1, 2, 3, 0)
    )
    source[::7], edited[::5] = np.nan, np.nan
    pairs = TrajectoryPairs.from_columns({"source": source, "edited": edited})
    section, both = protocol.plausibility, pairs.source_given & pairs.edited_given
    measured = measure(pairs, np.tile(FAR_AWAY, (400, 1, 1)), protocol.geometry)
    tracks = _as_checked(pairs)

    wrong = impossible_first_step(measured, protocol)[both]
    source_m, edited_m = (
        side.step_lengths_m[0][: tracks.n_both] for side in (tracks.source, tracks.edited)
    )
    assert wrong_first_steps(source_m, edited_m, protocol) == set(np.flatnonzero(wrong).tolist())
    in_order = np.concatenate(
        [np.flatnonzero(both), np.flatnonzero(pairs.edited_given & ~pairs.source_given)]
    )
    undrivable = (measured.peak_acceleration_mps2 > section.max_acceleration_mps2) | (
        measured.tightest_turn_m < section.min_turn_radius_m
    )
    assert undrivable_rows(tracks.edited, protocol) == set(
        np.flatnonzero(undrivable[in_order]).tolist()
    )
    progress = measured_progress(measured, section)[both]
    found = list(_progress(*tracks, section.progress_min_path_m))
    assert found == pytest.approx(progress[~np.isnan(progress)].tolist())
    for told in (wrong, undrivable, progress > 0.5):
        assert 0.05 < told.mean() < 0.95


def test_a_check_before_an_upload_tells_the_flags_of_motion_that_the_scorer_raises(
    protocol: ProtocolDocument,
) -> None:
    kinds = [0.3 * CRUISE, BACKING, JUMP, HAIRPIN, STILL, MISSING, 0.1 * CRUISE]
    told_before = Counter[str]()
    for seed in range(60):
        rng = np.random.default_rng(seed)
        source, edited = [CRUISE] * 30, [0.8 * CRUISE] * 30
        for side in (source, edited):
            for n in (rng.choice([0, 1, 2, 4, 20, 28]), rng.choice([0, 1, 2])):
                side[: int(n)] = [kinds[rng.integers(len(kinds))]] * int(n)
        flags = _codes(_judge(source, edited, protocol))
        pairs = TrajectoryPairs.from_columns(
            {"source": np.stack(source), "edited": np.stack(edited)}
        )
        told = [code for code, _ in motion_flags(_as_checked(pairs), 30, protocol)]
        assert told == [code for code in flags if code in MOTION]
        told_before.update(told)
    assert min(told_before[code] for code in MOTION) > 5
