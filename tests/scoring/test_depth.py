"""Depth of an intrusion, against shapes whose overlap is known and against a search."""

import math

import numpy as np
import pytest
from shapely import affinity
from shapely.geometry import MultiPoint, box
from shapely.geometry.base import BaseGeometry

from exceptiondrive_schemas.protocol import packaged_protocol
from exceptiondrive_scoring.depth import intrusion_depth_m

GEOMETRY = packaged_protocol().geometry
FRONT_M = GEOMETRY.footprint_centre_ahead_m + GEOMETRY.footprint_length_m / 2
HALF_WIDTH_M = GEOMETRY.footprint_width_m / 2


def standing(n: int = 1) -> np.ndarray:
    return np.zeros((n, 6, 2))


def region(low_x: float, high_x: float, low_y: float, high_y: float) -> np.ndarray:
    corners = [(low_x, low_y), (high_x, low_y), (high_x, high_y), (low_x, high_y)]
    return np.array([corners], dtype=float)


@pytest.mark.parametrize(
    ("corners", "depth_m"),
    [
        (region(FRONT_M - 0.3, FRONT_M + 5, -5, 5), 0.3),
        (region(-5, 9, HALF_WIDTH_M - 0.2, 5), 0.2),
        (region(FRONT_M + 0.1, FRONT_M + 5, -5, 5), 0.0),
        (region(FRONT_M - 0.3, FRONT_M + 5, HALF_WIDTH_M - 0.1, 5), 0.1),
        (np.array([[[FRONT_M - 0.3, 0], [FRONT_M - 0.3, 0], [9.0, -1], [9.0, 1]]]), 0.3),
    ],
)
def test_depth_is_the_shortest_way_out(corners: np.ndarray, depth_m: float) -> None:
    found = intrusion_depth_m(standing(), corners, GEOMETRY)
    assert found == pytest.approx([depth_m], abs=1e-12)


def test_the_deepest_footprint_counts() -> None:
    ahead = np.array([[[0.5 * step, 0.0] for step in range(1, 7)]])
    found = intrusion_depth_m(ahead, region(FRONT_M + 1, FRONT_M + 50, -50, 50), GEOMETRY)
    assert found == pytest.approx([2.0])


def test_a_missing_trajectory_has_no_depth() -> None:
    edited = np.full((1, 6, 2), np.nan)
    assert np.isnan(intrusion_depth_m(edited, region(0, 1, 0, 1), GEOMETRY)).all()


def test_no_shorter_way_out_is_found_by_a_search() -> None:
    """Regions of any shape, concave ones taken by their hull; ways in 720 directions."""
    chance = np.random.default_rng(5)
    car = box(FRONT_M - GEOMETRY.footprint_length_m, -HALF_WIDTH_M, FRONT_M, HALF_WIDTH_M)
    corners = chance.uniform(-3, 3, size=(40, 4, 2)) + chance.uniform(-3, 6, size=(40, 1, 2))
    depths_m = intrusion_depth_m(standing(40), corners, GEOMETRY)
    for points, depth_m in zip(corners, depths_m, strict=True):
        hull = MultiPoint(points).convex_hull
        ways_m = [_way_out_m(car, hull, math.radians(turn / 2)) for turn in range(720)]
        assert depth_m <= min(ways_m) + 1e-9
        assert depth_m == pytest.approx(min(ways_m), abs=0.02)


def _way_out_m(car: BaseGeometry, hull: BaseGeometry, direction_rad: float) -> float:
    """How far the car has to go this way until a line across it parts the two."""
    turned = [
        affinity.rotate(each, -direction_rad, (0, 0), use_radians=True) for each in (car, hull)
    ]
    return max(turned[1].bounds[2] - turned[0].bounds[0], 0.0) if car.intersects(hull) else 0.0
