"""How a planner's trajectories move: what plausibility looks at (PROTOCOL.md section 5)."""

import numpy as np

from exceptiondrive_schemas.protocol import GeometrySection
from exceptiondrive_scoring.aliases import FloatArray


def net_motion_m(waypoints_m: FloatArray) -> FloatArray:
    """Distance of the last waypoint from the start; (N, T, 2) -> (N,), NaN where missing."""
    last = waypoints_m[:, -1]
    return np.hypot(last[:, 0], last[:, 1])


def peak_acceleration_mps2(points_m: FloatArray, geometry: GeometrySection) -> FloatArray:
    """Largest change of velocity between consecutive steps.

    The speed before t = 0 is not known, so the first step has no acceleration.

    Args:
        points_m: (N, T + 1, 2), the origin first; NaN where missing.
        geometry: Time step.

    Returns:
        (N,) metres per second squared; 0 with fewer than two steps, NaN where missing.
    """
    x, y = (np.diff(points_m[..., axis].T, n=2, axis=0) for axis in (0, 1))
    peak = np.sqrt(np.max(x * x + y * y, axis=0, initial=0.0))
    result: FloatArray = peak / geometry.time_step_s**2
    return result


def tightest_turn_m(points_m: FloatArray, geometry: GeometrySection) -> FloatArray:
    """Radius of the tightest circle through three consecutive points.

    Where one of the two steps is too short to give a heading there is no circle.

    Args:
        points_m: (N, T + 1, 2), the origin first; NaN where missing.
        geometry: Hold length.

    Returns:
        (N,) metres; infinite on a straight line and where missing.
    """
    x, y = (np.diff(points_m[..., axis].T, axis=0) for axis in (0, 1))
    length = np.sqrt(x * x + y * y)
    moved = length > geometry.heading_hold_m + geometry.heading_hold_tolerance_m
    chord = np.hypot(x[1:] + x[:-1], y[1:] + y[:-1])
    doubled_area = np.abs(x[:-1] * y[1:] - y[:-1] * x[1:])
    bends = moved[1:] & moved[:-1] & (doubled_area > 0)
    product = length[1:] * length[:-1] * chord
    radius = np.full(product.shape, np.inf)
    np.divide(product, 2 * doubled_area, out=radius, where=bends)
    tightest: FloatArray = radius.min(axis=0, initial=np.inf)
    return tightest
