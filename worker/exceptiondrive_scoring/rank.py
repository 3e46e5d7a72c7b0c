"""Rank entries by the protocol, and give the range of ranks that the draws leave open."""

from bisect import bisect_left
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exceptiondrive_schemas.challenges import Order, RankKey
from exceptiondrive_schemas.score_sheet import MetricRow
from exceptiondrive_scoring.aliases import FloatArray, IntArray
from exceptiondrive_scoring.bootstrap import SAME_TO, Uncertainty
from exceptiondrive_scoring.interval import draws_cut_off, least_differing

CODED_AT_ONCE = 2**18
"""Number of values that fit into a processor's cache."""
PAIRED = 1_000
"""Number of leading entries that are compared pairwise, draw by draw: the cost is quadratic."""


def ranks(
    rows: Sequence[MetricRow], coverage_suffices: Sequence[bool], order: Sequence[RankKey]
) -> list[int | None]:
    """Rank entries (docs/protocol.md section 4).

    Args:
        rows: Metrics of each of K entries, rounded to the published precision.
        coverage_suffices: Whether each entry answers enough samples to rank.
        order: Keys; the first one decides, later ones break ties.

    Returns:
        K ranks; None where a value is undefined or coverage is too low.
    """
    keys = [
        _sort_key(row, order) if suffices else None
        for row, suffices in zip(rows, coverage_suffices, strict=True)
    ]
    ranked = sorted(key for key in keys if key is not None)
    return [None if key is None else 1 + bisect_left(ranked, key) for key in keys]


def _sort_key(row: MetricRow, order: Sequence[RankKey]) -> tuple[float, ...] | None:
    """Smaller is better; None where a value is undefined."""
    parts: list[float] = []
    for key in order:
        value = row.get(key.metric)
        if value is None:
            return None
        parts.append(-value if key.order == "descending" else value)
    return tuple(parts)


def rank_intervals(entries: Sequence[Uncertainty], order: Order, confidence: float) -> IntArray:
    """Return the best and worst rank that the draws allow each entry (docs/protocol.md section 4).

    Entry i is surely better than j if the interval of their paired difference lies above zero: if
    it is better in all draws but those that the interval cuts off. Their number is the smallest of
    that for the scenes in which the two differ and of those for both their intervals. If fewer
    scenes differ than `least_differing`, neither is surely better. The range is 1 + number of
    entries surely better ... K - number surely worse. Only pairs whose spans of draws overlap are
    compared.

    All are of one split and protocol, the order is that of the metric that ranks first; (K, 2).
    """
    n_entries = len(entries)
    if not entries:
        return np.empty((0, 2), dtype=np.intp)
    draws = np.stack([entry.primary_draws for entry in entries])
    if order == "ascending":
        draws = -draws
    cuts = np.array([entry.primary_cut for entry in entries])
    n_draws = draws.shape[1]
    low, high = _spans(draws)
    by_high = np.argsort(-high, kind="stable")
    codes, needed = _rank_codes(draws[by_high]), n_draws - cuts[by_high]
    scenes = _rank_codes(np.stack([entry.primary_scenes for entry in entries])[by_high], SAME_TO)
    n_told = least_differing(confidence)
    of_differing = n_draws - np.array(
        [draws_cut_off(n_draws, confidence, n) for n in range(scenes.shape[1] + 1)]
    )
    of_differing[:n_told] = n_draws + 1
    n_near = n_entries - np.searchsorted(np.sort(high), low[by_high])
    best = np.ones(n_entries, dtype=np.intp)
    worst = np.full(n_entries, n_entries)
    for i, end in enumerate(n_near):
        near, others = slice(i + 1, end), slice(i + 1, None)
        n_differing = np.count_nonzero(scenes[others] != scenes[i], axis=1)
        wins = n_differing >= n_told  # over entries whose span lies wholly below
        losses = np.zeros_like(wins)
        n_of_near = n_differing[: end - i - 1]
        least = np.maximum(np.maximum(needed[i], needed[near]), of_differing[n_of_near])
        wins[: len(least)] = np.count_nonzero(codes[i] > codes[near], axis=1) >= least
        losses[: len(least)] = np.count_nonzero(codes[i] < codes[near], axis=1) >= least
        best[i] += np.count_nonzero(losses)
        worst[i] -= np.count_nonzero(wins)
        best[others] += wins
        worst[others] -= losses
    return np.stack([best, worst], axis=1)[np.argsort(by_high)]


def long_rank_intervals(
    entries: Sequence[Uncertainty],
    intervals: FloatArray,
    order: Order,
    confidence: float,
    n_paired: int = PAIRED,
) -> IntArray:
    """Rank intervals of a board of any length: `rank_intervals` among the first `n_paired`.

    In any other pair, an entry is surely better if its interval lies wholly above the other's, as
    in `told_rank_intervals`. That takes n log n and gives wider ranges. Entries come best first;
    (K, 2).
    """
    found = told_rank_intervals(intervals, order)
    low, high = _more_is_better(intervals, order)
    better, worse = _count_apart(low[:n_paired], high[:n_paired], low[n_paired:], high[n_paired:])
    n_others = max(len(entries) - n_paired, 0)
    among = rank_intervals(entries[:n_paired], order, confidence)
    found[:n_paired] = among + np.stack([better, n_others - worse], axis=1)
    return found


def told_rank_intervals(intervals: FloatArray, order: Order) -> IntArray:
    """Return the best and worst rank of each entry that published intervals allow.

    Entry i is surely better than j if its interval lies wholly above that of j. Readers can derive
    this, so ranks of a withheld split reveal nothing more (docs/leakage.md). The intervals are the
    published ones of the metric that ranks first; a missing one spans all numbers. (K, 2).
    """
    low, high = _more_is_better(intervals, order)
    better, worse = _count_apart(low, high, low, high)
    return np.stack([1 + better, len(low) - worse], axis=1)


def _more_is_better(intervals: FloatArray, order: Order) -> tuple[FloatArray, FloatArray]:
    """Return lower and upper ends, signed so that more is better."""
    low, high = intervals.T if order == "descending" else -intervals[:, ::-1].T
    return low, high


def _count_apart(
    low: FloatArray, high: FloatArray, others_low: FloatArray, others_high: FloatArray
) -> tuple[IntArray, IntArray]:
    """Count the others whose interval lies wholly above that of each, and wholly below."""
    above = len(others_low) - np.searchsorted(np.sort(others_low), high, side="right")
    return above, np.searchsorted(np.sort(others_high), low, side="left")


def _spans(draws: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the lowest and the highest draw of each entry.

    If two spans do not overlap, the higher entry is better in all draws. The span of an entry that
    is undefined in some draws overlaps with every other.
    """
    is_undefined = np.isnan(draws).any(axis=1)
    low = np.where(is_undefined, -np.inf, draws.min(axis=1))
    return low, np.where(is_undefined, np.inf, draws.max(axis=1))


def _rank_codes(draws: FloatArray, same_to: float = 0.0) -> NDArray[Any]:
    """Return codes that compare within a draw as its values do, but faster.

    Values no further apart than `same_to` are equal.

    NaN compares with nothing, and so has no code: draws that contain one are returned unchanged.
    """
    if np.isnan(draws).any():
        return draws
    kind = np.uint16 if len(draws) <= np.iinfo(np.uint16).max else np.uint32
    codes = np.empty(draws.shape, dtype=kind)
    for few in np.array_split(np.arange(draws.shape[1]), -(-draws.size // CODED_AT_ONCE)):
        order = np.argsort(draws[:, few], axis=0)
        ordered = np.take_along_axis(draws[:, few], order, axis=0)
        steps = np.zeros(ordered.shape, dtype=kind)
        np.cumsum(np.diff(ordered, axis=0) > same_to, axis=0, out=steps[1:])
        codes[order, few] = steps
    return codes
