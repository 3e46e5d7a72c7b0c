"""Positions and steps, time-major: one row per time step, so that arithmetic runs over samples."""

from typing import NamedTuple

import numpy as np

from exceptiondrive_scoring.aliases import FloatArray


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
