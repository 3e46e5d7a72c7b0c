"""Counterfactual trajectory shift of a pair (PROTOCOL.md section 2; the paper's CTS)."""

from typing import NamedTuple

import numpy as np

from exceptiondrive_scoring.aliases import FloatArray
from exceptiondrive_scoring.arrays import TrajectoryPairs


class Shift(NamedTuple):
    """Mean over all T + 1 points; each (N,) metres, NaN where a trajectory is missing."""

    euclidean_m: FloatArray
    x_m: FloatArray
    y_m: FloatArray


def shift(pairs: TrajectoryPairs) -> Shift:
    """Mean distance of edited and source waypoints, and its two components.

    The origin counts as a point with shift 0, so the sums run over T points and are divided by
    T + 1. Missing trajectories are NaN and stay so.
    """
    # (T, N): sums over time then run along contiguous samples
    x = np.abs(pairs.edited[..., 0].T - pairs.source[..., 0].T)
    y = np.abs(pairs.edited[..., 1].T - pairs.source[..., 1].T)
    n_points = pairs.edited.shape[1] + 1
    both = pairs.source_given & pairs.edited_given
    distance = np.sqrt(x * x + y * y)
    means = (np.where(both, part.sum(axis=0) / n_points, np.nan) for part in (distance, x, y))
    return Shift(*means)
