import math
from dataclasses import replace
from typing import Any

import pytest

from exceptiondrive.conversion import (
    ConversionPlan,
    RawPair,
    Waypoints,
    convert,
    sensor_to_rear_axle,
)
from exceptiondrive.errors import InvalidArgumentError
from exceptiondrive_schemas.protocol import packaged_protocol

OFFSET_M = 0.943713
GEOMETRY = packaged_protocol().geometry
PLAN = ConversionPlan(GEOMETRY)


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
    right_of_it = tuple((1.0, 5.0 * step) for step in range(1, 7))
    result = convert((pair(right_of_it),), replace(PLAN, rotate_deg=-90))
    assert result.pairs[0].source == tuple((5.0 * step, -1.0) for step in range(1, 7))
    assert result.done == ("turned by -90 degrees: (x, y) -> (y, -x)",)


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
    plan = replace(PLAN, origin_offset_m=0.9, follows="rear-axle")
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
    for plan in (PLAN, replace(PLAN, truncate=True)):
        with pytest.raises(InvalidArgumentError, match="more than 6 waypoints, up to 7") as caught:
            convert((seven,), plan)
        assert "--time-step-s S" in caught.value.advice
    with pytest.raises(InvalidArgumentError) as caught:
        convert((seven,), replace(PLAN, time_step_s=0.5))
    assert caught.value.advice == "Add --truncate to keep the first 3 s.", "the step was said"
    result = convert((seven,), replace(PLAN, truncate=True, time_step_s=0.5))
    assert result.pairs == (pair(straight(6)),)
    assert result.done == ("cut 2 trajectories to the first 6 waypoints, 3 s",)


def test_one_file_never_mixes_with_and_without_t_0() -> None:
    """A seven-point trajectory at the origin beside one that is not: nothing is guessed."""
    pairs = (pair(((0.0, 0.0),) * 7), pair(straight(7), "s2"))
    with pytest.raises(InvalidArgumentError, match="4 trajectories have more than 6"):
        convert(pairs, PLAN)


def drives(step_s: float, n: int, from_s: float = 0.0) -> list[Waypoints]:
    """Thirty steady drives, each a tenth of a metre a second faster, and a car that stands."""
    times_s = [from_s + step_s * number for number in range(n)]
    speeds_mps = [0.0, *(3.0 + number / 10 for number in range(30))]
    return [tuple((speed * time_s, 0.0) for time_s in times_s) for speed in speeds_mps]


@pytest.mark.parametrize(("step_s", "n"), [(0.5, 6), (0.25, 12), (0.2, 15), (0.4, 8), (0.1, 30)])
def test_t_0_is_no_waypoint_where_none_is_to_spare(step_s: float, n: int) -> None:
    """Taken as the first one, it would move every place by a time step."""
    plan = replace(PLAN, time_step_s=step_s)
    sources = drives(step_s, n)
    for edited in (sources, drives(step_s, n, step_s)):
        pairs = tuple(map(RawPair, map(str, range(len(sources))), sources, edited))
        with pytest.raises(InvalidArgumentError) as caught:
            convert(pairs, plan)
        sentence = caught.value.sentence
        if edited is sources:
            assert f"62 trajectories are wrong, the first: 0: source has {n - 1}" in sentence
            assert f"waypoints beside t = 0, fewer than {plan.n_needed}." in sentence
        else:
            assert "30 trajectories are wrong, the first: 1: edited begins" in sentence


@pytest.mark.parametrize(("step_s", "power", "metres"), [(0.1, 2, 1.0), (0.01, 1, 4.5)])
def test_a_first_step_that_is_short_is_no_t_0(step_s: float, power: int, metres: float) -> None:
    """Thirty cars that pull away at 2 m/s2, seen ten times a second; or at 4.5 m/s, a hundred times."""
    times_s = [step_s * number for number in range(1, round(3.0 / step_s) + 1)]
    points = tuple((metres * time_s**power, 0.0) for time_s in times_s)
    pairs = tuple(pair(points, str(number)) for number in range(30))
    result = convert(pairs, replace(PLAN, time_step_s=step_s, truncate=True))
    assert result.pairs[0].source is not None
    assert result.pairs[0].source[0] == pytest.approx((metres * 0.5**power, 0.0))


def test_the_few_that_do_not_begin_at_t_0_are_named() -> None:
    plan = replace(PLAN, time_step_s=0.5, truncate=True)
    given = drives(0.5, 8)
    given[3] = ((0.3, 0.0), *given[3][1:])
    pairs = tuple(pair(points, str(number)) for number, points in enumerate(given))
    with pytest.raises(InvalidArgumentError, match="2 trajectories are wrong") as caught:
        convert(pairs, plan)
    assert "3: source begins 0.30 m from the origin" in caught.value.sentence
    result = convert(pairs, replace(plan, null_invalid=True))
    assert result.pairs[3] == RawPair("3", None, None)
    assert result.pairs[30].source == given[30][1:7]
    assert result.done[0].startswith("left out the first point of 60 trajectories")


def test_short_trajectories_are_never_padded() -> None:
    with pytest.raises(InvalidArgumentError, match="5 waypoints, fewer than 6") as caught:
        convert((pair(straight(5)),), replace(PLAN, truncate=True))
    assert "Nothing is made up" in caught.value.advice


def test_a_tenth_of_a_second_to_half_a_second_takes_one_waypoint_of_five() -> None:
    """Ten times a second at 5 m/s: the car is at 2.5 m after half a second, not after 2.5 s."""
    fine = tuple((0.5 * number, 0.0) for number in range(1, 61))
    result = convert((pair(fine),), replace(PLAN, time_step_s=0.1, truncate=True))
    assert result.pairs == (pair(tuple((2.5 * step, 0.0) for step in range(1, 7))),)
    assert result.done == (
        "took one waypoint of 5: 0.1 s to 0.5 s apart",
        "cut 2 trajectories to the first 6 waypoints, 3 s",
    )


@pytest.mark.parametrize(("step_s", "n"), [(0.2, 15), (0.3, 10), (1.0, 3), (1.5, 2), (0.25, 12)])
def test_any_time_step_gives_the_places_of_a_steady_drive(step_s: float, n: int) -> None:
    steady = tuple((4.0 * step_s * number, 1.0 * step_s * number) for number in range(1, n + 1))
    result = convert((pair(steady),), replace(PLAN, time_step_s=step_s))
    assert result.pairs[0].edited is not None
    places = tuple((2.0 * step, 0.5 * step) for step in range(1, 7))
    assert list(result.pairs[0].edited) == approximately(places)


def test_a_horizon_of_less_than_three_seconds_is_too_short() -> None:
    with pytest.raises(InvalidArgumentError, match="6 waypoints, fewer than 30"):
        convert((pair(straight(6)),), replace(PLAN, time_step_s=0.1))


WRONG: dict[str, tuple[dict[str, Any], Waypoints]] = {
    "centimetres": ({"unit": "centimetres"}, ((100.0, 200.0),) * 6),
    "swap": ({"swap": True}, ((2.0, 1.0),) * 6),
    "rotate back": ({"rotate_deg": 180}, ((-1.0, -2.0),) * 6),
    "rotate left": ({"rotate_deg": 90}, ((2.0, -1.0),) * 6),
    "mirror": ({"mirror": True}, ((1.0, -2.0),) * 6),
    "reverse": ({"reverse": True}, ((1.0, 2.0),) * 6),
    "cumulative": ({"cumulative": True}, ((1.0, 2.0), *((0.0, 0.0),) * 5)),
}


@pytest.mark.parametrize("name", WRONG)
def test_each_option_mends_its_mistake(name: str) -> None:
    changes, points = WRONG[name]
    result = convert((pair(points),), replace(PLAN, **changes))
    assert result.pairs[0].source is not None
    assert list(result.pairs[0].source) == approximately(((1.0, 2.0),) * 6)
    assert len(result.done) == 1


def test_reversing_turns_the_order_round() -> None:
    result = convert((pair(tuple(reversed(straight(6)))),), replace(PLAN, reverse=True))
    assert result.pairs == (pair(straight(6)),)


def test_source_and_edited_change_places() -> None:
    result = convert((RawPair("s1", straight(6), None),), replace(PLAN, exchange=True))
    assert result.pairs == (RawPair("s1", None, straight(6)),)
    assert result.done == ("exchanged source and edited",)


def test_what_is_invalid_becomes_null_and_is_listed() -> None:
    sound, wild = straight(6), (*straight(5), (900.0, 0.0))
    leap, short = (*straight(5), (45.0, 0.0)), straight(4)
    broken = ((math.nan, 0.0), *straight(5))
    pairs = (
        RawPair("s1", sound, wild),
        RawPair("s2", leap, short),
        RawPair("s3", broken, None),
    )
    result = convert(pairs, replace(PLAN, null_invalid=True))
    assert result.pairs == (
        RawPair("s1", sound, None),
        RawPair("s2", None, None),
        RawPair("s3", None, None),
    )
    assert result.nulled == (
        "s3: source holds a number that is not finite",
        "s2: edited has 4 waypoints, fewer than 6",
        "s1: edited has a coordinate of 900 m, out of bounds",
        "s2: source has a step of 40.00 m",
    )
    assert result.done == ("wrote null for 4 trajectories of 3 samples",)


def test_headings_are_left_out_and_said_so() -> None:
    result = convert((pair(tuple((*point, 0.1) for point in straight(6))),), PLAN)
    assert result.pairs == (pair(straight(6)),)
    assert result.done == (
        "kept the first two columns as x and y, of 2 trajectories, and left out the rest",
    )


def test_a_trajectory_of_two_columns_stays_beside_those_with_times() -> None:
    slow, fast = straight(6), tuple((2.0 * x, y) for x, y in straight(6))
    timed = [
        tuple((0.5 * step, *point) for step, point in enumerate(points)) for points in (slow, fast)
    ]
    result = convert((RawPair("s1", *timed), RawPair("s2", slow, None)), PLAN)
    assert result.pairs == (RawPair("s1", slow, fast), RawPair("s2", slow, None))
    assert result.done[0].startswith("kept x and y behind a column of times, of 2 trajectories,")


def test_camera_coordinates_stand_behind_a_column_of_times() -> None:
    slow, fast = straight(6), tuple((2.0 * x, 1.0) for x, _ in straight(6))
    timed, plain = (
        [
            tuple((*times, -y, 1.5, x) for times, (x, y) in zip(all_times, points, strict=True))
            for points in (slow, fast)
        ]
        for all_times in ([(0.5 * step,) for step in range(1, 7)], [()] * 6)
    )
    plan = replace(PLAN, camera=True)
    result = convert((RawPair("s1", *timed), RawPair("s2", *plain)), plan)
    assert result.pairs == (RawPair("s1", slow, fast), RawPair("s2", slow, fast))
    assert result.done == (
        "took camera coordinates, behind a column of times: (x right, y down, z ahead) -> (z, -x)",
    )


def test_headings_in_front_are_told_from_an_x_by_the_columns_behind() -> None:
    turning = tuple((3.0 * step, 1.5 * step) for step in range(1, 7))
    result = convert((pair(tuple((0.4, *point) for point in turning)),), PLAN)
    assert result.pairs == (pair(turning),)
    assert result.done[0].startswith("kept x and y behind a column of headings in radians, of 2")
    sideways = tuple((0.1 * step, 3.0 * step) for step in range(1, 7))
    result = convert((pair(tuple((*point, 0.4) for point in sideways)),), PLAN)
    assert result.pairs == (pair(sideways),), "x right, y forward and a heading behind"


def test_a_height_in_the_middle_is_no_y() -> None:
    turning = tuple((3.0 * step, 1.5 * step) for step in range(1, 7))
    result = convert((pair(tuple((x, 0.0, y) for x, y in turning)),), PLAN)
    assert result.pairs == (pair(turning),)
    assert "around a column of zeros" in result.done[0]


@pytest.mark.parametrize(
    ("points", "code"),
    [
        (((1.0,),) * 6, "wrong_waypoint_shape"),
        ((tuple(map(float, range(9))),) * 6, "wrong_waypoint_shape"),
        (((1.0, 2.0), *((1.0, 2.0, 0.0),) * 5), "wrong_waypoint_shape"),
        (((math.nan, 2.0),) * 6, "wrong_waypoint_shape"),
    ],
)
def test_what_is_not_a_trajectory_is_refused(points: Waypoints, code: str) -> None:
    with pytest.raises(InvalidArgumentError) as caught:
        convert((pair(points),), PLAN)
    assert caught.value.code == code


def test_turning_comes_before_the_offset() -> None:
    plan = replace(PLAN, rotate_deg=-90, origin_offset_m=OFFSET_M)
    lidar = tuple((0.0, float(step)) for step in range(7))
    result = convert((pair(lidar),), plan)
    assert result.pairs[0].source is not None
    assert list(result.pairs[0].source) == approximately(straight(6))
    assert [sentence.split()[0] for sentence in result.done] == ["turned", "turned", "left"]
