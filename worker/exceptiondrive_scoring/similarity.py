"""Similarity of two submissions, from what was submitted alone: no region, no score.

A fingerprint holds the answers to some samples. The samples follow from a seed that participants do
not know, so nobody can change just them. Fingerprints find candidates among a thousand submissions
at once; only candidates are compared sample by sample.
"""

import functools
import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from exceptiondrive_scoring.aliases import BoolArray, Columns, FloatArray

FINGERPRINT_SAMPLES = 256
FARTHEST = 2.0
"""Upper bound of distances, also used for a missing answer, so that no sample decides alone."""
SLACK = 0.1
"""Tolerance of fingerprints: candidates are the submissions that might be alike."""


LEAST_SCALE, FARTHEST_SHIFT = 0.8, 1.0
"""A copy scaled further, or shifted by more metres, counts as an independent planner."""
FIRST_LOOK = 64
"""Number of samples that suffice for most pairs to rule out a copy, scaled and shifted or not."""
ROUNDING = 1e-3
"""Metres: more than the rounding error of a fingerprint in 32 bits."""


@dataclass(frozen=True)
class Alikeness:
    """How similar the answers of two submissions are.

    Attributes:
        equal_share: Share of samples answered alike, to within the challenge's tolerance.
        mean_distance: Mean over samples, each at most `FARTHEST`; metres for trajectories.
        aligned_share: `equal_share` after one of the two is scaled and shifted as a whole.
        scale: The factor of this scaling; 1: as sent.
    """

    equal_share: float
    mean_distance: float
    aligned_share: float = 0.0
    scale: float = 1.0

    @property
    def best_share(self) -> float:
        """Share of samples answered alike, scaled and shifted or as sent."""
        return max(self.equal_share, self.aligned_share)


@dataclass(frozen=True)
class AlikeRule:
    """What is compared in a challenge, and when submissions are alike.

    Attributes:
        ways: Answers -> (N, P, C) float64: P points of C coordinates, NaN where missing.
        tolerance: Samples no farther apart than this are answered alike.
        equal_share: Submissions with at least this share of samples alike are reported.
        mean_distance: So are submissions with at most this mean distance; None: it is ignored.
        probe_share: With at least this share of samples alike, the later one probes the rest.
        may_be_scaled: Whether a copy may be disguised by scaling or shifting it as a whole.
    """

    ways: Callable[[Columns], FloatArray]
    tolerance: float
    equal_share: float
    mean_distance: float | None
    probe_share: float = 0.9
    may_be_scaled: bool = False

    @property
    def least_share(self) -> float:
        """The least share of samples alike that makes submissions alike, or the later a probe."""
        return min(self.equal_share, self.probe_share)

    def is_alike(self, found: Alikeness, slack: float = 0.0) -> bool:
        """Whether submissions of two teams are to be reported."""
        is_near = self.mean_distance is not None and (
            found.mean_distance <= self.mean_distance + slack
        )
        return is_near or found.best_share >= self.equal_share - slack

    def is_probe(self, found: Alikeness, slack: float = 0.0) -> bool:
        """Whether a submission differs from another in only a few samples.

        One that equals another when scaled or shifted as a whole probes no sample in particular.
        """
        if found.equal_share >= self.probe_share - slack:
            return True
        return self.probe_share - slack <= found.aligned_share < 1


@functools.lru_cache
def fingerprinted_samples(n_samples: int, seed: str) -> NDArray[np.intp]:
    """Return which of N samples a fingerprint holds: at most `FINGERPRINT_SAMPLES`, ascending."""
    number = int.from_bytes(hashlib.sha256(seed.encode()).digest()[:8], "big")
    chosen = np.random.default_rng(number).permutation(n_samples)[:FINGERPRINT_SAMPLES]
    return np.sort(chosen)


def distances(a: NDArray[np.floating], b: NDArray[np.floating]) -> FloatArray:
    """Return the distance of each sample, (..., N): mean over its points, at most `FARTHEST`.

    Args:
        a: (..., N, P, C), NaN where missing; broadcast against `b`.
        b: (..., N, P, C). If missing in both, the distance is 0; if in one, `FARTHEST`.
    """
    lengths = _lengths(a - b)
    apart = _sum(lengths) / lengths.shape[-1]
    if np.isnan(apart).any():
        is_missing = _is_missing(a), _is_missing(b)
        apart = np.where(is_missing[0] & is_missing[1], 0.0, apart)
        apart = np.where(is_missing[0] ^ is_missing[1], FARTHEST, apart)
    return np.asarray(np.minimum(apart, FARTHEST))


def _lengths(vectors: NDArray[np.floating]) -> NDArray[np.floating]:
    """Lengths (...) of vectors (..., C)."""
    return np.asarray(np.sqrt(_sum(vectors * vectors)))


def _sum(values: NDArray[np.floating]) -> NDArray[np.floating]:
    """Sum over the last axis, element by element: numpy is slow along a short axis."""
    return np.asarray(functools.reduce(np.add, np.moveaxis(values, -1, 0)))


def _is_missing(ways: NDArray[np.floating]) -> BoolArray:
    """Whether any coordinate of a sample is NaN, (..., N)."""
    return np.asarray(np.isnan(ways).reshape(*ways.shape[:-2], -1).any(axis=-1))


def alikeness(
    a: NDArray[np.floating], others: NDArray[np.floating], rule: AlikeRule
) -> list[Alikeness]:
    """Compare one submission (N, P, C) with K others (K, N, P, C)."""
    apart = distances(a[None], others)
    aligned, scales = np.zeros(len(others)), np.ones(len(others))
    if rule.may_be_scaled:
        scales = _alignment_scales(a, others)
        aligned = _share(distances(_aligned(a, others, scales), others), rule)
    columns = (_share(apart, rule), apart.mean(axis=-1), aligned, scales)
    return [Alikeness(*map(float, row)) for row in zip(*columns, strict=True)]


def may_be_alike(
    a: NDArray[np.floating], others: NDArray[np.floating], rule: AlikeRule, slack: float
) -> BoolArray:
    """Whether, by the first samples, a submission may be like each of K others, (K,).

    Most are so far apart that the remaining samples could not make up for the first ones.
    """
    n_samples, n_first = len(a), min(len(a), FIRST_LOOK)
    least_share = rule.least_share - slack
    apart = distances(a[None, :n_first], others[:, :n_first])
    n_alike = (apart <= rule.tolerance + ROUNDING).sum(axis=-1) + n_samples - n_first
    may = n_alike >= least_share * n_samples - ROUNDING
    if rule.mean_distance is not None:
        may |= apart.sum(axis=-1) <= (rule.mean_distance + slack + ROUNDING) * n_samples
    if rule.may_be_scaled:
        may |= _may_align(a, others, rule, least_share)
    return np.asarray(may)


def _share(apart: FloatArray, rule: AlikeRule) -> FloatArray:
    return np.asarray((apart <= rule.tolerance + 1e-9).mean(axis=-1))


def _alignment_scales(a: NDArray[np.floating], others: NDArray[np.floating]) -> FloatArray:
    """Return the factor that scales a submission onto each of K others; 1 if too far for a copy.

    The factor is a median, so that a few moved samples do not matter.
    """
    ends, of_others = (_lengths(ways[..., -1, :]) for ways in (a, others))
    moves = (ends[None] > 1) & (of_others > 1)
    ratio = np.sort(np.where(moves, of_others / np.where(moves, ends[None], 1), np.nan), axis=-1)
    n_known = np.count_nonzero(~np.isnan(ratio), axis=-1)  # NaN sorts last
    middle = np.maximum(n_known[:, None] - [1, 0], 0) // 2
    scales = np.take_along_axis(ratio, middle, axis=-1).mean(axis=-1)
    return np.where((scales >= LEAST_SCALE) & (scales <= 1 / LEAST_SCALE), scales, 1.0)


def _may_align(
    a: NDArray[np.floating],
    others: NDArray[np.floating],
    rule: AlikeRule,
    share: float,
) -> BoolArray:
    """Whether at least this share of samples may be alike once scaled and shifted, (K,).

    Samples that are alike were shifted alike, in the mean of their points. If too few of the first
    ones were, along some coordinate, the remaining ones cannot make up for it.
    """
    n_samples, n_first = len(a), min(len(a), FIRST_LOOK)
    first = others[:, :n_first]
    scales = _alignment_scales(a, others)[:, None, None, None].astype(a.dtype)
    gaps = first - a[None, :n_first] * scales
    moved = _sum(gaps.transpose(0, 3, 1, 2)) / gaps.shape[-2]  # (K, C, n)
    n_needed = np.full(len(others), n_first - math.floor((1 - share) * n_samples + 1e-9))
    if np.isnan(moved).any():  # missing in both: alike, however moved
        n_needed -= (_is_missing(a[None, :n_first]) & _is_missing(first)).sum(axis=-1)
    moved.sort(axis=-1)  # NaN sorts last
    begin = np.arange(n_first)
    end = np.minimum(begin + n_needed[:, None] - 1, n_first - 1)  # (K, n)
    spread = np.take_along_axis(moved, np.maximum(end, begin)[:, None], axis=-1) - moved
    is_whole = (begin + n_needed[:, None] <= n_first)[:, None]
    fits = ((spread <= 2 * rule.tolerance + ROUNDING) & is_whole).any(axis=-1).all(axis=-1)
    return np.asarray(fits | (n_needed <= 0))


def _aligned(
    a: NDArray[np.floating], others: NDArray[np.floating], scales: FloatArray
) -> NDArray[np.floating]:
    """Scale and shift a submission as a whole onto each of K others, by medians.

    It is not shifted further than a copy may be.
    """
    scaled = a[None] * scales[:, None, None, None]
    points = (others - scaled).reshape(len(others), a[..., 0].size, a.shape[-1])
    gaps = np.ascontiguousarray(np.moveaxis(points, -1, 1))  # (K, C, N * P)
    unknown = np.asarray(np.isnan(gaps).any(axis=1))
    if unknown.any():
        shifts = np.array([np.median(row[:, ~missing], axis=-1) if not missing.all()
                           else np.zeros(a.shape[-1])
                           for row, missing in zip(gaps, unknown, strict=True)])  # fmt: skip
    else:
        shifts = np.median(gaps, axis=-1)
    shifts = np.where(np.linalg.norm(shifts, axis=-1, keepdims=True) <= FARTHEST_SHIFT, shifts, 0.0)
    return np.asarray(scaled + shifts[:, None, None, :])


def compare_pair(a: FloatArray, b: FloatArray, rule: AlikeRule) -> tuple[Alikeness, int]:
    """Compare two submissions exactly; return also how many samples differ at all."""
    return alikeness(a, b[None], rule)[0], int((distances(a, b) > 0).sum())
