"""Clearance by hand. The vehicle of protocol 1.0 reaches from x = -0.556 to 3.528, y = +-0.925."""

from dataclasses import replace

import numpy as np
import pytest

from exceptiondrive_schemas.protocol import GeometrySection
from exceptiondrive_scoring.aliases import FloatArray
from exceptiondrive_scoring.clearance import clearance_m, touches_start
from exceptiondrive_scoring.region import prepare_regions

FRONT, REAR, SIDE = 3.528, 0.556, 0.925


def box(x0: float, y0: float, x1: float, y1: float) -> list[list[float]]:
    return [[x0, y0], [x1, y0], [x1, y1], [x0, y1]]


def straight(step_m: float, steps: int = 6) -> FloatArray:
    points = np.zeros((1, steps + 1, 2))
    points[0, :, 0] = step_m * np.arange(steps + 1)
    return points


def clearance_of(
    points_m: FloatArray, region: list[list[float]], geometry: GeometrySection
) -> float:
    return float(clearance_m(points_m, prepare_regions(np.array([region])), geometry)[0])


CASES = {
    "straight": (straight(2.0), box(20, -1, 22, 1), 20 - 12 - FRONT),
    "touching": (straight(2.0), box(12 + FRONT, -1, 20, 1), 0.0),
    "parallel_at_1m": (straight(2.0), box(4, SIDE + 1, 9, SIDE + 2), 1.0),
    "corner_to_corner": (
        straight(2.0),
        box(12 + FRONT + 3, SIDE + 4, 30, SIDE + 9),
        5.0,
    ),
    "standing": (straight(0.0), box(10, -1, 12, 1), 10 - FRONT),
    "reversing": (straight(-2.0), box(-20, -1, -15, 1), 15 - 12 - REAR),
    "behind": (straight(2.0), box(-8, -1, -5, 1), 5 - REAR),
    "tunnelling_between_waypoints": (straight(10.0), box(6.0, -0.1, 6.2, 0.1), 0.0),
    "passing_a_post_between_waypoints": (straight(10.0), box(6.0, 1.425, 6.2, 1.6), 0.5),
    "region_contains_the_tube": (straight(2.0), box(-50, -50, 50, 50), 0.0),
    "tube_contains_the_region": (straight(2.0), box(7.0, -0.1, 7.2, 0.1), 0.0),
    "footprint_contains_the_region": (straight(0.0), box(1.0, -0.1, 1.2, 0.1), 0.0),
}


@pytest.mark.parametrize("name", CASES)
def test_clearance_is_the_distance_worked_by_hand(name: str, geometry: GeometrySection) -> None:
    points, region, expected = CASES[name]
    assert clearance_of(points, region, geometry) == pytest.approx(expected, abs=1e-12)


def test_single_footprints_miss_what_lies_between_two_waypoints(geometry: GeometrySection) -> None:
    footprints = geometry.model_copy(update={"collision_tube": "footprints"})
    points, region, _ = CASES["tunnelling_between_waypoints"]
    assert clearance_of(points, region, footprints) == pytest.approx(6.0 - FRONT, abs=1e-12)


def test_a_vehicle_in_the_notch_of_a_concave_region_is_clear(geometry: GeometrySection) -> None:
    notch_at_6m = [[6.0, 0.0], [0.0, 30.0], [30.0, 0.0], [0.0, -30.0]]
    along_edge = np.array([-6.0, 30.0]) / np.hypot(6, 30)
    corner = np.array([FRONT, SIDE]) - [6.0, 0.0]
    expected = abs(along_edge[0] * corner[1] - along_edge[1] * corner[0])
    assert clearance_of(straight(0.0), notch_at_6m, geometry) == pytest.approx(expected, abs=1e-12)


def test_a_quarter_turn_to_the_left_sweeps_the_hull_of_both_footprints(
    geometry: GeometrySection,
) -> None:
    turn = np.array([[[0.0, 0.0], [0.0, 2.0]]])
    # heading 90 degrees at (0, 2): that footprint spans x +-0.925, y 1.444 ... 5.528
    front_right_of_first, front_right_of_second = np.array([FRONT, SIDE]), np.array([SIDE, 5.528])
    edge = front_right_of_second - front_right_of_first
    normal = np.array([-edge[1], edge[0]]) / np.hypot(*edge)
    outward = normal if normal @ [1.0, 1.0] > 0 else -normal
    middle = (front_right_of_first + front_right_of_second) / 2
    near = middle + 0.75 * outward
    region = near + np.array([[0.0, 0.0], [3.0, 0.2], [3.0, 3.0], [0.2, 3.0]])
    assert clearance_of(turn, region.tolist(), geometry) == pytest.approx(0.75, abs=1e-12)


@pytest.mark.parametrize("ahead_m", [-2.0, 1.486, 20.0])
def test_what_touches_the_start_is_what_a_standing_car_has_no_clearance_of(
    ahead_m: float, geometry: GeometrySection
) -> None:
    placed = geometry.model_copy(update={"footprint_centre_ahead_m": ahead_m})
    rng = np.random.default_rng(20)
    corners = np.array(box(-1, -1, 1, 1)) * rng.uniform(0.1, 8, (2000, 1, 2))
    regions = corners + rng.uniform(-25, 25, (2000, 1, 2))
    prepared = prepare_regions(regions)
    clear = clearance_m(np.zeros((2000, 7, 2)), prepared, placed)
    touching = touches_start(prepared, placed)
    assert 20 < touching.sum() < 1000
    np.testing.assert_array_equal(touching, clear <= geometry.contact_tolerance_m)


def test_no_samples_have_no_clearances(geometry: GeometrySection) -> None:
    empty = prepare_regions(np.empty((0, 4, 2)))
    assert clearance_m(np.empty((0, 7, 2)), empty, geometry).shape == (0,)


def test_the_inputs_are_not_changed(geometry: GeometrySection) -> None:
    points, region, _ = CASES["straight"]
    regions = prepare_regions(np.array([region]))
    before = points.copy(), replace(regions, x_m=regions.x_m.copy())
    clearance_m(points, regions, geometry)
    np.testing.assert_array_equal(points, before[0])
    np.testing.assert_array_equal(regions.x_m, before[1].x_m)
