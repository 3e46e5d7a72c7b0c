"""Shares and flags of docs/protocol.md section 5."""

from collections.abc import Callable

import numpy as np
import pytest

from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.score_sheet import Plausibility
from exceptiondrive_scoring.aliases import FloatArray
from exceptiondrive_scoring.arrays import SplitArrays, TrajectoryPairs
from exceptiondrive_scoring.kinematics import (
    peak_acceleration_mps2,
    positions,
    steps,
    tightest_turn_m,
)
from exceptiondrive_scoring.measure import measure
from exceptiondrive_scoring.plausibility import plausibility

STILL = np.zeros((6, 2))
CRUISE = np.stack([3.0 * np.arange(1, 7), np.zeros(6)], axis=-1)
JUMP = np.stack([[1, 2, 3, 23, 24, 25], np.zeros(6)], axis=-1).astype(float)
HAIRPIN = np.array([[2, 0], [4, 0], [4, 2], [2, 2], [0, 2], [-2, 2]], dtype=float)
MISSING = np.full((6, 2), np.nan)
FAR_AWAY = np.array([[60.0, 60.0], [62.0, 60.0], [62.0, 62.0], [60.0, 62.0]])


def _judge(
    source: list[FloatArray], edited: list[FloatArray], protocol: ProtocolDocument
) -> Plausibility:
    pairs = TrajectoryPairs.from_columns({"source": np.stack(source), "edited": np.stack(edited)})
    regions = np.broadcast_to(FAR_AWAY, (len(source), 4, 2))
    return plausibility(measure(pairs, regions, protocol.geometry), protocol.plausibility)


def _codes(judged: Plausibility) -> list[str]:
    return [flag.code for flag in judged.flags]


def test_an_ordinary_planner_raises_no_flag(protocol: ProtocolDocument) -> None:
    judged = _judge([CRUISE] * 4, [0.8 * CRUISE] * 4, protocol)
    assert judged.shares == {
        "edited_stationary": 0.0, "source_stationary": 0.0, "blind": 0.0, "impossible": 0.0,
    }  # fmt: skip
    assert judged.flags == ()


def test_stopping_for_the_edit_far_more_often_than_without_is_flagged(
    protocol: ProtocolDocument,
) -> None:
    judged = _judge([CRUISE] * 4, [STILL, STILL, 0.5 * CRUISE, 0.5 * CRUISE], protocol)
    assert judged.shares["edited_stationary"] == 0.5
    assert _codes(judged) == ["stands_still"]
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
    assert _codes(judged) == ["impossible_motion"]


def test_missing_trajectories_are_in_no_share(protocol: ProtocolDocument) -> None:
    judged = _judge([CRUISE, MISSING], [MISSING, MISSING], protocol)
    assert judged.shares == {
        "edited_stationary": None, "source_stationary": 0.0, "blind": None, "impossible": None,
    }  # fmt: skip
    assert judged.flags == ()


def test_acceleration_is_the_change_of_velocity_between_steps(protocol: ProtocolDocument) -> None:
    points = np.array([[[0, 0], [1, 0], [4, 0], [4, 4]]], dtype=float)
    # steps (1, 0) (3, 0) (0, 4) in 0.5 s: the largest change is (-3, 4), 5 / 0.25
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
    judged = plausibility(measured, protocol.plausibility)
    assert _codes(judged) == ["blind_to_the_edit"]  # its edited drive is its source drive
