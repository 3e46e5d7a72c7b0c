import math

import pytest

from exceptiondrive.conversion import (
    ConversionPlan,
    RawPair,
    Waypoints,
    convert,
    sensor_to_rear_axle,
    swap_axes,
)
from exceptiondrive.errors import InvalidArgumentError

OFFSET_M = 0.943713
PLAN = ConversionPlan(waypoints=6)


def straight(n: int, start: float = 1.0) -> Waypoints:
    return tuple((start + step, 0.0) for step in range(n))


def pair(points: Waypoints | None, sample_id: str = "s1") -> RawPair:
    return RawPair(sample_id, source=points, edited=points)


def approximately(points: Waypoints) -> list[object]:
    return [pytest.approx(point, abs=1e-9) for point in points]


def test_six_points_in_the_right_frame_need_nothing_done() -> None:
    result = convert((pair(straight(6)),), PLAN)
    assert result.pairs == (pair(straight(6)),)
    assert result.done == ()


def test_x_right_y_forward_becomes_x_forward_y_left() -> None:
    assert swap_axes(((1.0, 5.0),)) == ((5.0, -1.0),), "1 m to the right is y = -1"


def test_a_standing_car_stays_at_the_origin_whatever_the_offset() -> None:
    assert list(sensor_to_rear_axle(((0.0, 0.0),) * 6, OFFSET_M)) == approximately(
        ((0.0, 0.0),) * 6
    )


def test_straight_motion_of_the_sensor_is_the_same_motion_of_the_rear_axle() -> None:
    assert list(sensor_to_rear_axle(straight(6), OFFSET_M)) == approximately(straight(6))


def test_reversing_keeps_the_heading() -> None:
    back = tuple((-2.0 * step, 0.0) for step in range(1, 7))
    assert list(sensor_to_rear_axle(back, OFFSET_M)) == approximately(back)


def test_on_a_circle_the_rear_axle_keeps_its_distance_and_turns_inside() -> None:
    """Rear axle on radius 20 m; the sensor, 1 m ahead, runs on radius sqrt(401)."""
    radius_m, step_rad = 20.0, 0.05
    angles = [step_rad * step for step in range(1, 7)]
    axle = [(radius_m * math.sin(a), radius_m * (1 - math.cos(a))) for a in angles]
    sensor = tuple(
        (x + math.cos(a) - 1.0, y + math.sin(a)) for a, (x, y) in zip(angles, axle, strict=True)
    )
    for found, true in zip(sensor_to_rear_axle(sensor, 1.0), axle, strict=True):
        assert math.dist(found, true) < 0.03


def test_rear_axle_positions_seen_from_the_sensor_are_shifted() -> None:
    plan = ConversionPlan(waypoints=6, origin_offset_m=0.9, follows="rear-axle")
    seen_from_sensor = tuple((x - 0.9, y) for x, y in ((0.0, 0.0), *straight(6)))
    result = convert((pair(seen_from_sensor),), plan)
    assert result.pairs[0].source is not None
    assert list(result.pairs[0].source) == approximately(straight(6))
    assert len(result.done) == 2


def test_the_first_of_seven_points_goes_where_all_begin_at_the_origin() -> None:
    seven = ((0.0, 0.04), *straight(6))
    result = convert((pair(seven), RawPair("s2", source=None, edited=seven)), PLAN)
    assert result.pairs == (pair(straight(6)), RawPair("s2", None, straight(6)))
    assert result.done == (
        "left out the first point of 3 trajectories: within 0.05 m of the origin, it is t = 0",
    )


def test_seven_points_that_begin_elsewhere_are_a_longer_horizon() -> None:
    seven = pair(straight(7))
    with pytest.raises(InvalidArgumentError, match="Add --truncate"):
        convert((seven,), PLAN)
    result = convert((seven,), ConversionPlan(waypoints=6, truncate=True))
    assert result.pairs == (pair(straight(6)),)
    assert result.done == ("cut 2 trajectories to their first 6 waypoints",)


def test_one_file_never_mixes_with_and_without_t_0() -> None:
    """A seven-point trajectory at the origin beside one that is not: nothing is guessed."""
    pairs = (pair(((0.0, 0.0),) * 7), pair(straight(7), "s2"))
    with pytest.raises(InvalidArgumentError, match="4 trajectories have more than 6"):
        convert(pairs, PLAN)


def test_short_trajectories_are_never_padded() -> None:
    with pytest.raises(InvalidArgumentError, match="fewer than 6 waypoints") as caught:
        convert((pair(straight(5)),), ConversionPlan(waypoints=6, truncate=True))
    assert "Nothing is made up" in caught.value.advice


def test_headings_are_left_out_and_said_so() -> None:
    result = convert((pair(tuple((*point, 0.1) for point in straight(6))),), PLAN)
    assert result.pairs == (pair(straight(6)),)
    assert result.done == ("left out the heading (third column) of 2 trajectories",)


@pytest.mark.parametrize(
    ("points", "code"),
    [
        (((1.0,),) * 6, "wrong_waypoint_shape"),
        (((1.0, 2.0, 3.0, 4.0),) * 6, "wrong_waypoint_shape"),
        (((1.0, 2.0), *((1.0, 2.0, 0.0),) * 5), "wrong_waypoint_shape"),
        (((math.nan, 2.0),) * 6, "non_finite"),
    ],
)
def test_what_is_not_a_trajectory_is_refused(points: Waypoints, code: str) -> None:
    with pytest.raises(InvalidArgumentError) as caught:
        convert((pair(points),), PLAN)
    assert caught.value.code == code


def test_swap_comes_before_the_offset() -> None:
    plan = ConversionPlan(waypoints=6, swap_axes=True, origin_offset_m=OFFSET_M)
    lidar = tuple((0.0, float(step)) for step in range(7))
    result = convert((pair(lidar),), plan)
    assert result.pairs[0].source is not None
    assert list(result.pairs[0].source) == approximately(straight(6))
    assert [sentence.split()[0] for sentence in result.done] == ["swapped", "turned", "left"]
