"""Rank intervals by paired comparison: how many entries are surely better, and surely worse."""

from collections.abc import Sequence
from typing import Literal

import numpy as np

from exceptiondrive_scoring.aliases import FloatArray, IntArray
from exceptiondrive_scoring.interval import draws_cut_off


def rank_intervals(
    primary_draws: Sequence[FloatArray],
    order: Literal["descending", "ascending"],
    confidence: float,
) -> IntArray:
    """Best and worst rank of each entry that the draws leave open (PROTOCOL.md section 4).

    Entry i is surely better than j if the interval of their paired difference lies wholly above
    zero, that is if it is better in all draws but those that the interval cuts off. The range is
    1 + number of entries surely better ... K - number surely worse.

    Args:
        primary_draws: K arrays (B,) of the same draws: only the entries that rank.
        order: Whether more is better (`descending`) or less.
        confidence: For example 0.95.

    Returns:
        (K, 2).
    """
    draws = np.stack(primary_draws) if len(primary_draws) else np.empty((0, 0))
    if order == "ascending":
        draws = -draws
    n_entries, n_draws = draws.shape
    needed = n_draws - int(draws_cut_off(n_draws, confidence))
    best = np.ones(n_entries, dtype=np.intp)
    worst = np.full(n_entries, n_entries, dtype=np.intp)
    for i in range(n_entries):
        others = draws[i + 1 :]
        wins = np.count_nonzero(draws[i] > others, axis=1) >= needed
        losses = np.count_nonzero(draws[i] < others, axis=1) >= needed
        best[i] += np.count_nonzero(losses)
        worst[i] -= np.count_nonzero(wins)
        best[i + 1 :] += wins
        worst[i + 1 :] -= losses
    return np.stack([best, worst], axis=1)
