"""Rank entries by the protocol, and say which ranks the draws leave open."""

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from exceptiondrive_schemas.challenges import RankKey
from exceptiondrive_scoring.aliases import IntArray
from exceptiondrive_scoring.bootstrap import Uncertainty


def ranks(
    values: Mapping[str, Sequence[float | None]],
    coverage_suffices: Sequence[bool],
    order: Sequence[RankKey],
) -> list[int | None]:
    """Rank entries (docs/protocol.md section 4).

    Args:
        values: Metric key to the value of each of K entries, rounded to the published precision.
        coverage_suffices: Whether each entry answers enough samples to rank.
        order: Keys, the first one decides.

    Returns:
        K ranks; None where a value is undefined or coverage is too low.
    """
    keys = [_sort_key(values, order, index) for index in range(len(coverage_suffices))]
    ranked = sorted(
        key for key, suffices in zip(keys, coverage_suffices, strict=True) if suffices and key
    )
    first: dict[tuple[float, ...], int] = {}
    for position, key in enumerate(ranked, start=1):
        first.setdefault(key, position)
    return [
        first[key] if suffices and key else None
        for key, suffices in zip(keys, coverage_suffices, strict=True)
    ]


def _sort_key(
    values: Mapping[str, Sequence[float | None]], order: Sequence[RankKey], index: int
) -> tuple[float, ...] | None:
    """Smaller is better; None where a value is undefined."""
    parts: list[float] = []
    for key in order:
        value = values[key.metric][index]
        if value is None:
            return None
        parts.append(-value if key.order == "descending" else value)
    return tuple(parts)


def rank_intervals(
    entries: Sequence[Uncertainty], order: Literal["descending", "ascending"]
) -> IntArray:
    """Best and worst rank of each entry that the draws leave open (docs/protocol.md section 4).

    Entry i is surely better than j if the interval of their paired difference lies wholly above
    zero, that is if it is better in all draws but those that the interval cuts off. The range is
    1 + number of entries surely better ... K - number surely worse.

    Args:
        entries: Primary draws of the K entries that rank, all of one split and protocol.
        order: Of the metric that ranks first: whether more is better (`descending`) or less.

    Returns:
        (K, 2).
    """
    n_entries = len(entries)
    draws = np.stack([entry.primary_draws for entry in entries]) if entries else np.empty((0, 0))
    if order == "ascending":
        draws = -draws
    needed = draws.shape[1] - np.array([entry.primary_cut for entry in entries])
    best = np.ones(n_entries, dtype=np.intp)
    worst = np.full(n_entries, n_entries, dtype=np.intp)
    for i in range(n_entries):
        others, of_both = draws[i + 1 :], np.maximum(needed[i], needed[i + 1 :])
        wins = np.count_nonzero(draws[i] > others, axis=1) >= of_both
        losses = np.count_nonzero(draws[i] < others, axis=1) >= of_both
        best[i] += np.count_nonzero(losses)
        worst[i] -= np.count_nonzero(wins)
        best[i + 1 :] += wins
        worst[i + 1 :] -= losses
    return np.stack([best, worst], axis=1)
