"""The kernel against a naive shapely loop that shares no code with it, on awkward sets."""

import importlib.util
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from exceptiondrive_schemas.protocol import GeometrySection
from exceptiondrive_scoring.aliases import FloatArray
from exceptiondrive_scoring.arrays import TrajectoryPairs
from exceptiondrive_scoring.measure import measure

N, T = 120, 6
FRONT, SIDE = 3.528, 0.925
Oracle = Callable[[FloatArray, FloatArray, GeometrySection], FloatArray]
Case = tuple[FloatArray, FloatArray]


ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def naive_clearances_m() -> Callable[[FloatArray, FloatArray, GeometrySection], FloatArray]:
    """The naive shapely loop of the benchmarks: it shares no code with the scoring package."""
    spec = importlib.util.spec_from_file_location("naive", ROOT / "benchmarks" / "naive.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    function: Callable[[FloatArray, FloatArray, GeometrySection], FloatArray]
    function = module.naive_clearances_m
    return function


def polar_quads(rng: np.random.Generator, centre: FloatArray, reach: float) -> FloatArray:
    """Simple quadrilaterals around their centres, about one in four concave."""
    angle = np.sort(rng.uniform(0, 0.5 * np.pi, (N, 4)) + 0.5 * np.pi * np.arange(4), axis=1)
    radius = rng.uniform(0.2, 1.0, (N, 4)) * reach
    return centre[:, None] + np.stack([np.cos(angle), np.sin(angle)], -1) * radius[..., None]


def drive(rng: np.random.Generator, speed: float = 2.0, bend: float = 0.2) -> FloatArray:
    heading = np.cumsum(rng.normal(0, bend, (N, T)), axis=1)
    length = rng.uniform(0, speed, (N, T))
    return np.cumsum(np.stack([np.cos(heading), np.sin(heading)], -1) * length[..., None], axis=1)


def near_path(rng: np.random.Generator, waypoints: FloatArray, spread: float) -> FloatArray:
    return waypoints[np.arange(N), rng.integers(0, T, N)] + rng.normal(0, spread, (N, 2))


def boxes(x0: FloatArray, y0: FloatArray, size: float = 2.0) -> FloatArray:
    x1, y1 = x0 + size, y0 + size
    return np.stack([np.stack(c, -1) for c in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))], axis=1)


def gaps(rng: np.random.Generator) -> FloatArray:
    return rng.choice([-1e-3, -1e-7, -1e-12, 0.0, 1e-12, 1e-7, 1e-5, 1e-3], N)


def random_drives(rng: np.random.Generator) -> Case:
    waypoints = drive(rng)
    return waypoints, polar_quads(rng, near_path(rng, waypoints, 4.0), 3.0)


def fast_drives_past_small_regions(rng: np.random.Generator) -> Case:
    waypoints = drive(rng, speed=15.0, bend=0.3)
    return waypoints, polar_quads(rng, near_path(rng, waypoints, 3.0), 0.4)


def far_regions(rng: np.random.Generator) -> Case:
    return drive(rng), polar_quads(rng, rng.uniform(40, 90, (N, 2)), 5.0)


def standing(rng: np.random.Generator) -> Case:
    return np.zeros((N, T, 2)), polar_quads(rng, rng.normal(0, 6, (N, 2)), 2.0)


def creeping_about_the_hold_length(rng: np.random.Generator) -> Case:
    waypoints = np.cumsum(rng.normal(0, 0.08, (N, T, 2)), axis=1)
    return waypoints, polar_quads(rng, rng.normal(0, 6, (N, 2)), 2.0)


def stopping_midway(rng: np.random.Generator) -> Case:
    waypoints = drive(rng)
    waypoints[:, 3:] = waypoints[:, 2:3]
    return waypoints, polar_quads(rng, near_path(rng, waypoints, 4.0), 2.0)


def reversing(rng: np.random.Generator) -> Case:
    waypoints = -drive(rng)
    return waypoints, polar_quads(rng, near_path(rng, waypoints, 4.0), 2.0)


def forth_and_back(rng: np.random.Generator) -> Case:
    waypoints = drive(rng)
    waypoints[:, 3:] = waypoints[:, 2::-1]
    return waypoints, polar_quads(rng, near_path(rng, waypoints, 4.0), 2.0)


def random_walks(rng: np.random.Generator) -> Case:
    waypoints = np.cumsum(rng.normal(0, 2.0, (N, T, 2)), axis=1)
    return waypoints, polar_quads(rng, near_path(rng, waypoints, 6.0), 2.0)


def quarter_turns(rng: np.random.Generator) -> Case:
    heading = np.cumsum(rng.choice([-0.5, 0.0, 0.5], (N, T)), axis=1) * np.pi
    steps = np.rint(np.stack([np.cos(heading), np.sin(heading)], -1))
    waypoints = np.cumsum(steps * rng.integers(1, 5, (N, 1, 1)), axis=1)
    return waypoints, polar_quads(rng, near_path(rng, waypoints, 5.0), 2.0)


def nearly_touching_fronts(rng: np.random.Generator) -> Case:
    waypoints = np.zeros((N, T, 2))
    waypoints[:, :, 0] = np.linspace(1, 6, T)
    return waypoints, boxes(6 + FRONT + gaps(rng), rng.uniform(-2.5, 0.5, N))


def nearly_touching_sides(rng: np.random.Generator) -> Case:
    waypoints = np.zeros((N, T, 2))
    waypoints[:, :, 0] = np.linspace(1, 6, T)
    return waypoints, boxes(rng.uniform(-1, 8, N), SIDE + gaps(rng))


def nearly_touching_corners(rng: np.random.Generator) -> Case:
    waypoints = np.zeros((N, T, 2))
    waypoints[:, :, 0] = np.linspace(1, 6, T)
    return waypoints, boxes(6 + FRONT + gaps(rng), SIDE + gaps(rng))


def nearly_touching_turned(rng: np.random.Generator) -> Case:
    waypoints, regions = nearly_touching_corners(rng)
    angle = rng.uniform(-0.5, 0.5, N)
    cos, sin = np.cos(angle), np.sin(angle)
    rotation = np.stack([np.stack([cos, sin], -1), np.stack([-sin, cos], -1)], axis=1)
    start = np.zeros((N, 1, 2))
    start[:, 0, 0] = 1e-3  # a short first step keeps heading 0; later steps take the angle
    return np.concatenate([start, (waypoints @ rotation)[:, 1:]], axis=1), regions @ rotation


def collinear_but_apart(rng: np.random.Generator) -> Case:
    waypoints = np.zeros((N, T, 2))
    waypoints[:, :, 0] = np.linspace(1, 6, T)
    return waypoints, boxes(6 + FRONT + rng.uniform(0.1, 5, N), np.full(N, SIDE))


def contained_regions(rng: np.random.Generator) -> Case:
    waypoints = drive(rng, bend=0.02)
    return waypoints, polar_quads(rng, waypoints[:, 3] + [1.5, 0.0], 0.3)


def containing_regions(rng: np.random.Generator) -> Case:
    return drive(rng), polar_quads(rng, np.zeros((N, 2)), 90.0)


def in_the_notch(rng: np.random.Generator) -> Case:
    notch = np.stack([rng.uniform(3.4, 8, N), rng.normal(0, 0.3, N)], -1)
    far = np.array([[0, 0], [-6, 20], [20, 0], [-6, -20]])
    return np.zeros((N, T, 2)), notch[:, None] + far


def triangles_with_a_repeated_corner(rng: np.random.Generator) -> Case:
    waypoints, regions = random_drives(rng)
    regions = regions.copy()
    regions[:, 3] = regions[:, 2]
    return waypoints, regions


def regions_with_a_straight_corner(rng: np.random.Generator) -> Case:
    waypoints, regions = random_drives(rng)
    regions = regions.copy()
    regions[:, 1] = (regions[:, 0] + regions[:, 2]) / 2
    return waypoints, regions


SETS = (
    random_drives, fast_drives_past_small_regions, far_regions, standing,
    creeping_about_the_hold_length, stopping_midway, reversing, forth_and_back, random_walks,
    quarter_turns, nearly_touching_fronts, nearly_touching_sides, nearly_touching_corners,
    nearly_touching_turned, collinear_but_apart, contained_regions, containing_regions,
    in_the_notch, triangles_with_a_repeated_corner, regions_with_a_straight_corner,
)  # fmt: skip


def assert_agrees(case: Case, geometry: GeometrySection, oracle: Oracle) -> FloatArray:
    waypoints, regions = case
    given = np.ones(N, dtype=np.bool_)
    pairs = TrajectoryPairs(waypoints, waypoints, given, given)
    measured = measure(pairs, regions, geometry)
    expected = oracle(waypoints, regions, geometry)
    np.testing.assert_allclose(measured.clearance_m, expected, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(measured.intrusion, expected <= geometry.contact_tolerance_m)
    clockwise = measure(pairs, regions[:, ::-1], geometry)
    np.testing.assert_allclose(clockwise.clearance_m, expected, rtol=0, atol=1e-9)
    return expected


@pytest.mark.parametrize("make", SETS, ids=lambda make: str(make.__name__))
@pytest.mark.parametrize("tube", ["hulls", "footprints"])
def test_the_kernel_agrees_with_a_naive_loop(
    make: Callable[[np.random.Generator], Case],
    tube: str,
    geometry: GeometrySection,
    naive_clearances_m: Oracle,
) -> None:
    chosen = geometry.model_copy(update={"collision_tube": tube})
    assert_agrees(make(np.random.default_rng(7)), chosen, naive_clearances_m)


def test_a_tube_that_may_turn_by_more_than_a_right_angle_agrees_too(
    geometry: GeometrySection, naive_clearances_m: Oracle
) -> None:
    never_reversing = geometry.model_copy(update={"reverse_above_deg": 180.0})
    case = random_walks(np.random.default_rng(7))
    expected = assert_agrees(case, never_reversing, naive_clearances_m)
    assert (expected > 0).any()
    assert (expected != naive_clearances_m(*case, geometry)).any()


def test_another_vehicle_agrees_too(geometry: GeometrySection, naive_clearances_m: Oracle) -> None:
    pacifica = geometry.model_copy(
        update={
            "footprint_length_m": 5.176,
            "footprint_width_m": 2.297,
            "footprint_centre_ahead_m": 1.461,
        }
    )
    assert_agrees(random_drives(np.random.default_rng(7)), pacifica, naive_clearances_m)
