"""Heading of the vehicle at every time step (docs/protocol.md section 2).

A heading is held as its unit vector: the rules need only dot products, and no angle is ever
wrapped.
"""

import math

import numpy as np

from exceptiondrive_schemas.protocol import GeometrySection
from exceptiondrive_scoring.aliases import BoolArray, FloatArray
from exceptiondrive_scoring.positions import Steps, positions, steps

ANGLE_ROUNDING = 1e-12
"""A right angle is not an obtuse one because of the last bits of a dot product."""


def heading_vectors(moves: Steps, geometry: GeometrySection) -> tuple[FloatArray, FloatArray]:
    """Cosine and sine of the heading at every time step.

    The heading starts at 0, follows each step, is kept over a step that is too short, and is turned
    by pi where the step points backwards: the car is reversing.

    Args:
        moves: Steps of N trajectories.
        geometry: Hold length and reversing angle.

    Returns:
        Two (T + 1, N) arrays.
    """
    n_steps, n_samples = moves.length_m.shape
    moved = has_heading(moves, geometry)
    reversing_below = math.cos(math.radians(geometry.reverse_above_deg)) - ANGLE_ROUNDING
    scale = np.divide(1.0, moves.length_m, out=np.zeros_like(moves.length_m), where=moved)
    along_x, along_y = moves.x_m * scale, moves.y_m * scale
    cos, sin = np.ones((n_steps + 1, n_samples)), np.zeros((n_steps + 1, n_samples))
    for t, is_moving in enumerate(moved):
        forward = along_x[t] * cos[t] + along_y[t] * sin[t]
        sign = np.where(forward < reversing_below, -1.0, 1.0)
        cos[t + 1] = np.where(is_moving, sign * along_x[t], cos[t])
        sin[t + 1] = np.where(is_moving, sign * along_y[t], sin[t])
    return cos, sin


def has_heading(moves: Steps, geometry: GeometrySection) -> BoolArray:
    """Whether each step is long enough to tell where the car points, (T, N)."""
    longer: BoolArray = moves.length_m > geometry.heading_hold_m + geometry.heading_hold_tolerance_m
    return longer


def headings_rad(points_m: FloatArray, geometry: GeometrySection) -> FloatArray:
    """Heading at every time step, counter-clockwise from +x, in (-pi, pi].

    Args:
        points_m: (N, T + 1, 2) positions, the origin first.
        geometry: Hold length and reversing angle.

    Returns:
        (N, T + 1).
    """
    cos, sin = heading_vectors(steps(positions(points_m)), geometry)
    headings: FloatArray = np.arctan2(sin, cos).T
    return headings
