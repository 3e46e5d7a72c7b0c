"""Rank entries by the protocol, and say which ranks the draws leave open."""

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
"""Values: what a processor's cache holds."""
PAIRED = 1_000
"""So many of the first entries are compared draw by draw, each with each: work of the square of it."""


def ranks(
    rows: Sequence[MetricRow], coverage_suffices: Sequence[bool], order: Sequence[RankKey]
) -> list[int | None]:
    """Rank entries (docs/protocol.md section 4).

    Args:
        rows: Metrics of each of K entries, rounded to the published precision.
        coverage_suffices: Whether each entry answers enough samples to rank.
        order: Keys, the first one decides.

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
    """Best and worst rank of each entry that the draws leave open (docs/protocol.md section 4).

    Entry i is surely better than j if the interval of their paired difference lies wholly above
    zero, that is if it is better in all draws but those that the interval cuts off: as few as the scenes
    in which the two differ allow, and the intervals of both. Of fewer than `least_differing` none is. The
    range is 1 + number of entries surely better ... K - number surely worse.

    Draws are compared pair by pair for those alone whose spans of draws meet.

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
        wins = n_differing >= n_told  # over who lies wholly below
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

    Of two that are not both among them, the one is surely better whose interval lies wholly above
    the other's, as in `told_rank_intervals`. That is n log n, and wider. The first entries stand first;
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
    """Best and worst rank of each entry that published intervals leave open.

    Entry i is surely better than j if its interval lies wholly above that of j. Whoever reads the
    intervals can say so: of a withheld split ranks tell nothing besides (docs/leakage.md). They are those
    of the metric that ranks first, as they are told; of an entry that has none, all numbers. (K, 2).
    """
    low, high = _more_is_better(intervals, order)
    better, worse = _count_apart(low, high, low, high)
    return np.stack([1 + better, len(low) - worse], axis=1)


def _more_is_better(intervals: FloatArray, order: Order) -> tuple[FloatArray, FloatArray]:
    """Return lower and upper ends, more being better."""
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

    Of two whose spans lie apart, the higher one is better in all draws. An entry that some draws leave
    undefined lies apart from none.
    """
    is_undefined = np.isnan(draws).any(axis=1)
    low = np.where(is_undefined, -np.inf, draws.min(axis=1))
    return low, np.where(is_undefined, np.inf, draws.max(axis=1))


def _rank_codes(draws: FloatArray, same_to: float = 0.0) -> NDArray[Any]:
    """Return numbers that stand to each other within a draw as its values do, and compare faster.

    Values are the same that lie no further apart than `same_to`.

    NaN stands to nothing, and so to no number: draws that hold one stay as they are.
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
