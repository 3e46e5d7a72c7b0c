"""Positions, steps and headings of trajectories, and how they move (docs/protocol.md sections 2, 5).

Time-major: one row per time step, so that arithmetic runs over samples. A heading is held as its unit
vector: the rules need only dot products, and no angle is ever wrapped.
"""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from exceptiondrive_schemas.protocol import GeometrySection
from exceptiondrive_scoring.aliases import BoolArray, FloatArray


class Positions(NamedTuple):
    """Reference points of N trajectories, the origin first: two (T + 1, N) arrays, metres."""

    x_m: FloatArray
    y_m: FloatArray


class Steps(NamedTuple):
    """Displacements between consecutive positions: three (T, N) arrays, metres."""

    x_m: FloatArray
    y_m: FloatArray
    length_m: FloatArray


def positions(points_m: FloatArray) -> Positions:
    """Rearrange points, (N, T + 1, 2) with the origin first."""
    return Positions(*np.ascontiguousarray(points_m.transpose(2, 1, 0)))


def positions_of_waypoints(waypoints_m: FloatArray) -> Positions:
    """Rearrange submitted waypoints, (N, T, 2), and put the origin (0, 0) in front."""
    n_samples, n_waypoints, _ = waypoints_m.shape
    points_m = np.zeros((2, n_waypoints + 1, n_samples))
    points_m[:, 1:] = waypoints_m.transpose(2, 1, 0)
    return Positions(*points_m)


def steps(at: Positions) -> Steps:
    """Displacement from each position to the next."""
    x_m, y_m = at.x_m[1:] - at.x_m[:-1], at.y_m[1:] - at.y_m[:-1]
    return Steps(x_m, y_m, np.sqrt(x_m * x_m + y_m * y_m))


ANGLE_ROUNDING = 1e-12
"""Tolerance by which rounding in a dot product does not make a right angle obtuse."""


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
    """Whether each step is long enough to define a heading, (T, N)."""
    longer: BoolArray = moves.length_m > geometry.heading_hold_m + geometry.heading_hold_tolerance_m
    return longer


class Progress(NamedTuple):
    """How far trajectories get along paths; each (N,) metres, NaN where the path is missing.

    Attributes:
        reached_m: Arc length at which the last position lies on the path; NaN where that is missing.
        path_m: Length of the path.
    """

    reached_m: FloatArray
    path_m: FloatArray


def progress_along(
    path: Positions, moves: Steps, end_x_m: FloatArray, end_y_m: FloatArray
) -> Progress:
    """Project ends, (N,) each, onto the polylines of N paths (docs/protocol.md section 9).

    Gives the arc length of the polyline's nearest point; if several are equally near, of the first.
    """
    from_x, from_y = end_x_m - path.x_m[:-1], end_y_m - path.y_m[:-1]
    square = moves.length_m * moves.length_m
    along = from_x * moves.x_m + from_y * moves.y_m
    along /= np.where(square > 0, square, 1.0)
    share = np.clip(along, 0.0, 1.0)
    gap_x, gap_y = from_x - share * moves.x_m, from_y - share * moves.y_m
    nearest = np.argmin(gap_x * gap_x + gap_y * gap_y, axis=0)[None]
    reached = moves.length_m.copy()
    for before, so_far in pairwise(reached):  # cumsum would process one path at a time
        so_far += before
    arc = reached + (share - 1.0) * moves.length_m
    return Progress(np.take_along_axis(arc, nearest, axis=0)[0], reached[-1])


class PathFit(NamedTuple):
    """Distance of a source trajectory from the recorded one; each (N,) metres, NaN where undefined."""

    source_l2_m: FloatArray
    source_l2_1s_m: FloatArray
    source_l2_2s_m: FloatArray
    source_l2_3s_m: FloatArray


def path_fit(source_m: FloatArray, recorded_m: FloatArray, geometry: GeometrySection) -> PathFit:
    """Mean over the T waypoints, and at 1, 2 and 3 s (docs/protocol.md section 9).

    Args:
        source_m: (N, T, 2) submitted waypoints, NaN where missing.
        recorded_m: (N, T, 2) recorded ones, NaN where unknown.
        geometry: Its time step maps times to waypoints.
    """
    x, y = np.moveaxis(source_m - recorded_m, -1, 0)
    gaps = np.sqrt(x * x + y * y)
    found = [gaps.mean(axis=1)]
    for time_s in (1.0, 2.0, 3.0):
        index = round(time_s / geometry.time_step_s) - 1
        is_there = 0 <= index < gaps.shape[1] and math.isclose(
            (index + 1) * geometry.time_step_s, time_s
        )
        found.append(gaps[:, index].copy() if is_there else np.full(len(gaps), np.nan))
    return PathFit(*found)


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

    With steps u and v that is |u| |v| |u + v| / (2 |u x v|). Where one of them is too short to
    define a heading there is no circle.

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


class Shift(NamedTuple):
    """Mean over all T + 1 points; each (N,) metres, NaN where a trajectory is missing."""

    euclidean_m: FloatArray
    x_m: FloatArray
    y_m: FloatArray


def shift(source: Positions, edited: Positions) -> Shift:
    """Mean distance of edited and source positions, and its two components.

    The origin counts as a point, with shift 0. Missing trajectories are NaN and give NaN.
    """
    x, y = np.abs(edited.x_m - source.x_m), np.abs(edited.y_m - source.y_m)
    return Shift(*(part.mean(axis=0) for part in (np.sqrt(x * x + y * y), x, y)))
