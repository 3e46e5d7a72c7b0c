"""Heading of the vehicle at every time step (PROTOCOL.md section 2).

Trajectories are held time-major, `(T + 1, N)`, so that every step of a recursion over time is one
operation on contiguous samples. A heading is held as its unit vector: the rules need only dot
products, and no angle is ever wrapped.
"""

import math

import numpy as np

from exceptiondrive_schemas.protocol import GeometrySection
from exceptiondrive_scoring.aliases import FloatArray

ANGLE_ROUNDING = 1e-12
"""A right angle is not an obtuse one because of the last bits of a dot product."""


def with_origin(waypoints_m: FloatArray) -> FloatArray:
    """Put (0, 0) in front of submitted waypoints: (N, T, 2) -> (N, T + 1, 2)."""
    n_samples, n_waypoints, _ = waypoints_m.shape
    points_m = np.zeros((n_samples, n_waypoints + 1, 2))
    points_m[:, 1:] = waypoints_m
    return points_m


def heading_vectors(
    x_m: FloatArray, y_m: FloatArray, geometry: GeometrySection
) -> tuple[FloatArray, FloatArray]:
    """Cosine and sine of the heading at every time step.

    The heading starts at 0, follows each step, is kept over a step that is too short, and is turned
    by pi where the step points backwards: the car is reversing.

    Args:
        x_m: (T + 1, N) longitudinal positions.
        y_m: (T + 1, N) lateral positions.
        geometry: Hold length and reversing angle.

    Returns:
        Two (T + 1, N) arrays.
    """
    step_x, step_y = np.diff(x_m, axis=0), np.diff(y_m, axis=0)
    length = np.hypot(step_x, step_y)
    moved = length > geometry.heading_hold_m + geometry.heading_hold_tolerance_m
    reversing_below = math.cos(math.radians(geometry.reverse_above_deg)) - ANGLE_ROUNDING
    scale = np.divide(1.0, length, out=np.zeros_like(length), where=moved)
    step_x *= scale
    step_y *= scale
    cos, sin = np.ones_like(x_m), np.zeros_like(x_m)
    for t, is_moving in enumerate(moved):
        forward = step_x[t] * cos[t] + step_y[t] * sin[t]
        sign = np.where(forward < reversing_below, -1.0, 1.0)
        cos[t + 1] = np.where(is_moving, sign * step_x[t], cos[t])
        sin[t + 1] = np.where(is_moving, sign * step_y[t], sin[t])
    return cos, sin


def headings_rad(points_m: FloatArray, geometry: GeometrySection) -> FloatArray:
    """Heading at every time step, counter-clockwise from +x, in (-pi, pi].

    Args:
        points_m: (N, T + 1, 2) positions, the origin first.
        geometry: Hold length and reversing angle.

    Returns:
        (N, T + 1).
    """
    cos, sin = heading_vectors(points_m[..., 0].T, points_m[..., 1].T, geometry)
    headings: FloatArray = np.arctan2(sin, cos).T
    return headings
