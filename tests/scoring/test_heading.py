"""The heading rule of docs/protocol.md section 2, by hand."""

import numpy as np
import pytest

from exceptiondrive_schemas.protocol import GeometrySection
from exceptiondrive_scoring.aliases import FloatArray
from exceptiondrive_scoring.kinematics import heading_vectors, positions, steps

CASES: dict[str, tuple[list[tuple[float, float]], list[float]]] = {
    "straight": ([(1, 0), (2, 0), (3, 0)], [0, 0, 0, 0]),
    "to_the_left": ([(1, 0), (2, 1), (2, 2)], [0, 0, 45, 90]),
    "standing": ([(0, 0), (0, 0), (0, 0)], [0, 0, 0, 0]),
    "stop_keeps_the_heading": ([(1, 1), (1.05, 1), (1.05, 1.05)], [0, 45, 45, 45]),
    "a_step_of_the_hold_length_is_held": ([(0, 0.10), (0, 0.20), (0, 0.35)], [0, 0, 0, 90]),
    "rounding_does_not_end_the_hold": ([(0, 0.1 + 1e-9), (0, 1), (0, 2)], [0, 0, 90, 90]),
    "reversing": ([(-1, 0), (-2, 0), (-3, 0)], [0, 0, 0, 0]),
    "reversing_in_a_bend": ([(-1, -0.1), (-2, -0.3), (-3, -0.6)], [0, 5.711, 11.310, 16.699]),
    "a_right_angle_is_not_reversing": ([(0, 1), (-1, 1), (-1, 0)], [0, 90, 180, -90]),
    "forth_and_back": ([(2, 2), (0, 0), (2, 2)], [0, 45, 45, 45]),
}


def headings_rad(points_m: FloatArray, geometry: GeometrySection) -> FloatArray:
    """Heading at every time step, counter-clockwise from +x; (N, T + 1)."""
    cos, sin = heading_vectors(steps(positions(points_m)), geometry)
    headings: FloatArray = np.arctan2(sin, cos).T
    return headings


def with_origin(waypoints: FloatArray) -> FloatArray:
    return np.concatenate([np.zeros((len(waypoints), 1, 2)), waypoints], axis=1)


@pytest.mark.parametrize("name", CASES)
def test_headings_follow_the_rule(name: str, geometry: GeometrySection) -> None:
    waypoints, expected_deg = CASES[name]
    points = with_origin(np.array([waypoints], dtype=float))
    degrees = np.degrees(headings_rad(points, geometry)[0])
    np.testing.assert_allclose(degrees, expected_deg, atol=1e-3)


def test_a_right_angle_in_any_direction_is_not_reversing(geometry: GeometrySection) -> None:
    angle = np.linspace(-1.5, 1.5, 101)
    first = np.stack([np.cos(angle), np.sin(angle)], -1)
    second = first + np.stack([-first[:, 1], first[:, 0]], -1)
    headings = headings_rad(with_origin(np.stack([first, second], axis=1)), geometry)
    np.testing.assert_allclose(headings[:, 2] - headings[:, 1], np.pi / 2)
