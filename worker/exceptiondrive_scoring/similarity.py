"""How alike two submissions are: from what was submitted alone, no region, no score.

A fingerprint is what some samples were answered with. Which samples those are follows from a seed
that participants do not know, so nobody can change just them. Fingerprints find candidates among a
thousand submissions at once; only candidates are compared sample by sample.
"""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from exceptiondrive_scoring.aliases import Columns, FloatArray

FINGERPRINT_SAMPLES = 256
FARTHEST = 2.0
"""Distances beyond this, and to a missing answer, count as this: one sample never decides."""
SLACK = 0.1
"""What a fingerprint may be off by: candidates are those that might be alike."""


@dataclass(frozen=True)
class Alikeness:
    """How far apart the answers of two submissions are.

    Attributes:
        equal_share: Share of samples answered alike, to within the challenge's tolerance.
        mean_distance: Mean over samples, each at most `FARTHEST`; metres for trajectories.
    """

    equal_share: float
    mean_distance: float


@dataclass(frozen=True)
class AlikeRule:
    """What of a challenge is compared, and what is alike.

    Attributes:
        ways: Answers -> (N, P, C) float64: P points of C coordinates, NaN where missing.
        tolerance: Samples no farther apart than this are answered alike.
        equal_share: Submissions with so many samples alike are reported.
        mean_distance: So are submissions no farther apart; None: not judged by distance.
        probe_share: Two submissions of one team with so many samples alike ask about the rest.
    """

    ways: Callable[[Columns], FloatArray]
    tolerance: float
    equal_share: float
    mean_distance: float | None
    probe_share: float = 0.99

    def is_alike(self, found: Alikeness, slack: float = 0.0) -> bool:
        """Whether submissions of two teams are to be reported."""
        is_near = self.mean_distance is not None and (
            found.mean_distance <= self.mean_distance + slack
        )
        return is_near or found.equal_share >= self.equal_share - slack

    def is_probe(self, found: Alikeness, slack: float = 0.0) -> bool:
        """Whether a submission differs from another of its team in a few samples only."""
        return found.equal_share >= self.probe_share - slack


def fingerprinted_samples(n_samples: int, seed: str) -> NDArray[np.intp]:
    """Return which of N samples a fingerprint holds: at most `FINGERPRINT_SAMPLES`, ascending."""
    number = int.from_bytes(hashlib.sha256(seed.encode()).digest()[:8], "big")
    chosen = np.random.default_rng(number).permutation(n_samples)[:FINGERPRINT_SAMPLES]
    return np.sort(chosen)


def distances(a: NDArray[np.floating], b: NDArray[np.floating]) -> FloatArray:
    """Return the distance of each sample, (..., N): mean over its points, at most `FARTHEST`.

    Args:
        a: (..., N, P, C), NaN where missing; broadcast against `b`.
        b: (..., N, P, C). Missing in both is no distance, in one the farthest.
    """
    apart = np.linalg.norm(a - b, axis=-1).mean(axis=-1)
    is_missing = np.isnan(a).any(axis=(-1, -2)), np.isnan(b).any(axis=(-1, -2))
    apart = np.where(is_missing[0] & is_missing[1], 0.0, apart)
    apart = np.where(is_missing[0] ^ is_missing[1], FARTHEST, apart)
    return np.minimum(apart, FARTHEST)


def alikeness(apart: FloatArray, tolerance: float) -> list[Alikeness]:
    """Sum up distances (K, N) of one submission to K others."""
    shares = (apart <= tolerance + 1e-9).mean(axis=-1)
    means = apart.mean(axis=-1)
    return [Alikeness(float(s), float(m)) for s, m in zip(shares, means, strict=True)]


def compare_pair(a: FloatArray, b: FloatArray, rule: AlikeRule) -> tuple[Alikeness, int]:
    """Compare two submissions exactly; return also how many samples differ at all."""
    apart = distances(a, b)
    return alikeness(apart[None], rule.tolerance)[0], int((apart > 0).sum())
