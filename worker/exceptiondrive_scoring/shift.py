"""Counterfactual trajectory shift of a pair (docs/protocol.md section 2; the paper's CTS)."""

from typing import NamedTuple

import numpy as np

from exceptiondrive_scoring.aliases import FloatArray
from exceptiondrive_scoring.positions import Positions


class Shift(NamedTuple):
    """Mean over all T + 1 points; each (N,) metres, NaN where a trajectory is missing."""

    euclidean_m: FloatArray
    x_m: FloatArray
    y_m: FloatArray


def shift(source: Positions, edited: Positions) -> Shift:
    """Mean distance of edited and source positions, and its two components.

    The origin counts as a point, with shift 0. Missing trajectories are NaN and stay so.
    """
    x, y = np.abs(edited.x_m - source.x_m), np.abs(edited.y_m - source.y_m)
    return Shift(*(part.mean(axis=0) for part in (np.sqrt(x * x + y * y), x, y)))
