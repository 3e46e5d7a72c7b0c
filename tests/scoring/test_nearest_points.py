"""The clearance segment of a drawing, against the kernel and against shapely."""

import numpy as np
import pytest
from shapely import Polygon, unary_union
from shapely.geometry.base import BaseGeometry
from shapely.ops import nearest_points

from exceptiondrive_schemas.protocol import GeometrySection
from exceptiondrive_scoring.clearance import clearance_m
from exceptiondrive_scoring.drawing import clearance_segment_m, tube_pieces_m
from exceptiondrive_scoring.region import prepare_regions

Case = tuple[np.ndarray, np.ndarray]


@pytest.fixture
def cases() -> list[Case]:
    """Bent trajectories and turned regions, one concave; some meet and some do not."""
    random = np.random.default_rng(7)
    corners = np.array([[0.0, -1.0], [3.0, -1.5], [2.0, 0.2], [0.3, 1.0]])
    found = []
    for _ in range(60):
        steps = random.uniform([0.0, -1.2], [5.0, 1.2], size=(6, 2))
        points = np.concatenate([np.zeros((1, 2)), steps.cumsum(axis=0)])
        angle = random.uniform(0, 2 * np.pi)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        found.append((points, corners @ turn.T + random.uniform([-8, -9], [30, 9])))
    return found


def _tube(points: np.ndarray, geometry: GeometrySection) -> BaseGeometry:
    return unary_union([Polygon(piece) for piece in tube_pieces_m(points, geometry)])


@pytest.mark.parametrize("kind", ["hulls", "footprints"])
def test_the_segment_is_as_long_as_the_clearance_and_ends_on_both_outlines(
    cases: list[Case], geometry: GeometrySection, kind: str
) -> None:
    geometry = geometry.model_copy(update={"collision_tube": kind})
    n_apart = 0
    for points, region in cases:
        tube, hazard = _tube(points, geometry), Polygon(region)
        if tube.intersects(hazard):
            continue
        n_apart += 1
        segment = clearance_segment_m(points, region, geometry)
        kernel = clearance_m(points[None], prepare_regions(region[None]), geometry)[0]
        assert segment.length_m == pytest.approx(kernel, abs=1e-9)
        on_tube, on_region = nearest_points(tube, hazard)
        np.testing.assert_allclose(segment.on_tube_m, on_tube.coords[0], atol=1e-6)
        np.testing.assert_allclose(segment.on_region_m, on_region.coords[0], atol=1e-6)
    assert n_apart > 15


def test_it_does_not_matter_which_way_the_region_turns(
    cases: list[Case], geometry: GeometrySection
) -> None:
    points, region = cases[0]
    one, other = (clearance_segment_m(points, r, geometry) for r in (region, region[::-1]))
    np.testing.assert_allclose(one.on_region_m, other.on_region_m)
