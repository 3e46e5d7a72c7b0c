"""The hull of any two footprints, however they lie and turn, against shapely's."""

from collections.abc import Callable

import numpy as np
import pytest
from shapely import MultiPoint, Polygon

from exceptiondrive_scoring.aliases import FloatArray
from exceptiondrive_scoring.convex_distance import hull_distance_m
from exceptiondrive_scoring.footprint import Footprints

N = 400
Draw = Callable[[np.random.Generator], FloatArray]
HALF_LENGTH_M, HALF_WIDTH_M = 2.042, 0.925
TURNS: dict[str, Draw] = {
    "any": lambda rng: rng.uniform(-np.pi, np.pi, N),
    "beyond a right angle": lambda rng: rng.uniform(0.5, 1.0, N) * np.pi * rng.choice([-1, 1], N),
    "none": lambda rng: np.zeros(N),
    "a hair": lambda rng: rng.choice([-1e-9, 1e-15, 1e-12, 1e-6], N),
    "right angles": lambda rng: rng.integers(-2, 3, N) * np.pi / 2,
    "about right angles": lambda rng: rng.integers(-2, 3, N) * np.pi / 2 + rng.normal(0, 1e-9, N),
}
STEPS: dict[str, Draw] = {
    "anywhere": lambda rng: rng.normal(0, 6, (2, N)),
    "overlapping": lambda rng: rng.normal(0, 0.5, (2, N)),
    "on the spot": lambda rng: np.zeros((2, N)),
    "a hair away": lambda rng: rng.choice([-1e-15, 1e-14, 1e-12, 1e-8], (2, N)),
    "straight ahead": lambda rng: np.stack([rng.uniform(-12, 12, N), np.zeros(N)]),
}


def footprints(x: FloatArray, y: FloatArray, heading: FloatArray) -> Footprints:
    return Footprints(x, y, np.cos(heading), np.sin(heading), HALF_LENGTH_M, HALF_WIDTH_M)


def rectangles(rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Corners of region pieces, counter-clockwise: two (4, N) arrays."""
    sizes = rng.choice([0.01, 0.4, 3.0], (2, 1, N))
    turned = rng.uniform(-np.pi, np.pi, N)
    ahead, left = sizes * np.array([[1, -1, -1, 1], [1, 1, -1, -1]])[:, :, None]
    x, y = rng.normal(0, 5, (2, N))
    cos, sin = np.cos(turned), np.sin(turned)
    return x + ahead * cos - left * sin, y + ahead * sin + left * cos


@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("step", STEPS)
def test_the_distance_is_that_of_the_hull_of_both(turn: str, step: str) -> None:
    rng = np.random.default_rng(7)
    heading = rng.uniform(-np.pi, np.pi, N)
    ahead, left = STEPS[step](rng)
    x, y = rng.normal(0, 2, (2, N))
    a = footprints(x, y, heading)
    b_x, b_y = x + ahead * a.cos - left * a.sin, y + ahead * a.sin + left * a.cos
    b = footprints(b_x, b_y, heading + TURNS[turn](rng))
    region_x, region_y = rectangles(rng)
    corners = np.concatenate([np.stack(box.corners_m(), axis=-1) for box in (a, b)])
    region = np.stack([region_x, region_y], axis=-1)
    expected = [
        MultiPoint(corners[:, n]).convex_hull.distance(Polygon(region[:, n])) for n in range(N)
    ]
    assert sum(distance == 0 for distance in expected) > N / 20
    assert hull_distance_m(a, b, region_x, region_y) == pytest.approx(expected, abs=1e-9)
