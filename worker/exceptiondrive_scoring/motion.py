"""How a planner's trajectories move: what plausibility looks at (docs/protocol.md section 5)."""

import numpy as np

from exceptiondrive_schemas.protocol import GeometrySection
from exceptiondrive_scoring.aliases import FloatArray
from exceptiondrive_scoring.heading import has_heading
from exceptiondrive_scoring.positions import Positions, Steps


def net_motion_m(at: Positions) -> FloatArray:
    """Distance of the last position from the start, (N,); NaN where missing."""
    net: FloatArray = np.hypot(at.x_m[-1], at.y_m[-1])
    return net


def peak_acceleration_mps2(moves: Steps, geometry: GeometrySection) -> FloatArray:
    """Largest change of velocity between consecutive steps.

    The speed before t = 0 is not known, so the first step has no acceleration.

    Returns:
        (N,) metres per second squared; 0 with fewer than two steps, NaN where missing.
    """
    x, y = moves.x_m[1:] - moves.x_m[:-1], moves.y_m[1:] - moves.y_m[:-1]
    x *= x
    y *= y
    x += y
    peak: FloatArray = np.sqrt(x.max(axis=0, initial=0.0)) / geometry.time_step_s**2
    return peak


def tightest_turn_m(moves: Steps, geometry: GeometrySection) -> FloatArray:
    """Radius of the tightest circle through three consecutive positions.

    With steps u and v that is |u| |v| |u + v| / (2 |u x v|). Where one of them is too short to give
    a heading there is no circle.

    Returns:
        (N,) metres; infinite on a straight line and where missing.
    """
    ux, uy, u = (part[:-1] for part in moves)
    vx, vy, v = (part[1:] for part in moves)
    moved = has_heading(moves, geometry)
    chord_x, chord_y = ux + vx, uy + vy
    doubled_area = 2 * np.abs(ux * vy - uy * vx)
    product = u * v * np.sqrt(chord_x * chord_x + chord_y * chord_y)
    radius = np.full(product.shape, np.inf)
    bends = moved[:-1] & moved[1:] & (doubled_area > 0)
    np.divide(product, doubled_area, out=radius, where=bends)
    tightest: FloatArray = radius.min(axis=0, initial=np.inf)
    return tightest
