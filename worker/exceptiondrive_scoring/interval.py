"""Intervals: percentiles of bootstrap draws, and Wilson where draws cannot vary."""

from statistics import NormalDist

import numpy as np

from exceptiondrive_scoring.aliases import BoolArray, FloatArray, IntArray

ROUNDING = 1e-9
"""`1 - 0.95` is a little more than 0.05; the number of draws cut off must not depend on that."""


def draws_cut_off(n_draws: int | IntArray, confidence: float) -> IntArray:
    """How many draws lie outside the interval at each end."""
    return np.floor(np.asarray(n_draws) * (1 - confidence) / 2 + ROUNDING).astype(np.intp)


def percentile_intervals(draws: FloatArray, confidence: float) -> FloatArray:
    """Order statistics that leave `draws_cut_off` draws outside at each end.

    No interpolation: the low end is above zero exactly if at most so many draws are not, which is
    what `rank_intervals` counts. Draws of NaN (no such sample drawn) are left out.

    Args:
        draws: (..., B).
        confidence: For example 0.95.

    Returns:
        (..., 2) low and high; NaN without a defined draw.
    """
    missing = np.isnan(draws)
    if missing.any():
        return _intervals_of_defined(np.sort(draws, axis=-1), ~missing, confidence)
    cut = int(draws_cut_off(draws.shape[-1], confidence))
    ends = [cut, draws.shape[-1] - 1 - cut]
    found: FloatArray = np.partition(draws, ends, axis=-1)[..., ends]
    return found


def _intervals_of_defined(ordered: FloatArray, defined: BoolArray, confidence: float) -> FloatArray:
    """Sorting has put the draws of NaN last."""
    n_defined = defined.sum(axis=-1)
    cut = draws_cut_off(n_defined, confidence)
    ends = np.stack([cut, np.maximum(n_defined - 1 - cut, 0)], axis=-1)
    return np.take_along_axis(ordered, ends, axis=-1)


def wilson_interval(fraction: FloatArray, n: FloatArray, confidence: float) -> FloatArray:
    """Wilson's score interval of a fraction.

    A value in [0, 1] varies at most as much as a coin with the same mean, so for the mean of such
    values (HCC) the interval is conservative.

    Args:
        fraction: (...,) in [0, 1].
        n: (...,) number of independent observations, broadcastable.
        confidence: For example 0.95.

    Returns:
        (..., 2) low and high.
    """
    z = NormalDist().inv_cdf((1 + confidence) / 2)
    n = np.maximum(n, 1)
    centre = (fraction + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * np.sqrt(fraction * (1 - fraction) / n + z * z / (4 * n * n))
    return np.stack([np.maximum(centre - half, 0.0), np.minimum(centre + half, 1.0)], axis=-1)


def wilson_at_the_ends(intervals: FloatArray, n: FloatArray, confidence: float) -> FloatArray:
    """Replace intervals of fractions that shrank to the point 0 or 1: every draw gave the same."""
    low, high = intervals[..., 0], intervals[..., 1]
    stuck = (low == high) & ((low == 0) | (low == 1))
    return np.where(stuck[..., None], wilson_interval(low, n, confidence), intervals)
