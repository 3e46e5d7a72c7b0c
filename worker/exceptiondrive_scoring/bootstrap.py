"""Bootstrap over scenes: how far a score would move on another draw of scenes.

One scene carries up to 21 samples, so scenes are drawn, not samples (PROTOCOL.md section 4). Draws
come from the protocol's seed alone and are the same for every entry: comparisons are paired.

Each entry is computed by itself, in blocks of fixed shape. So its intervals do not depend, not even
in the last bit, on which other entries stand on the board, and memory does not grow with them.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from exceptiondrive_schemas.challenges import Challenge
from exceptiondrive_schemas.protocol import RankingSection
from exceptiondrive_scoring.aliases import BoolArray, FloatArray, IntArray
from exceptiondrive_scoring.interval import percentile_intervals, wilson_at_the_ends
from exceptiondrive_scoring.scene_sums import SceneSums

BLOCK_DRAWS = 250
BLOCK_ENTRIES = 8
FEWEST_SCENES = 2
"""One scene drawn again and again says nothing about another scene."""


@dataclass(frozen=True)
class Draws:
    """Metric means in each of B draws; NaN where a draw holds no sample that defines one.

    Attributes:
        micro: (M, B).
        macro_family: (M, B).
        families: (F, M, B).
    """

    micro: FloatArray
    macro_family: FloatArray
    families: FloatArray

    def headline(self, aggregate: str) -> FloatArray:
        """Draws of the aggregate with this name, `micro` or `macro_family`."""
        return {"micro": self.micro, "macro_family": self.macro_family}[aggregate]


@dataclass(frozen=True)
class Uncertainty:
    """Intervals of one entry: low and high along the last axis, NaN where undefined.

    Attributes:
        micro: (M, 2).
        macro_family: (M, 2).
        families: (F, M, 2).
        primary_draws: (B,) headline of the metric that ranks first: for `rank_intervals`.
    """

    micro: FloatArray
    macro_family: FloatArray
    families: FloatArray
    primary_draws: FloatArray


def bootstrap(
    entries: Iterable[SceneSums], challenge: Challenge, ranking: RankingSection, headline: str
) -> list[Uncertainty]:
    """Intervals of every metric, overall (both aggregates) and by family.

    Args:
        entries: Scene sums over one split; read block by block, so a generator saves memory.
        challenge: Metrics in column order.
        ranking: Draws, seed, confidence, rank order.
        headline: `micro` or `macro_family`.
    """
    is_fraction = np.array([metric.unit == "fraction" for metric in challenge.metrics])
    primary = challenge.metric_keys.index(ranking.order[challenge.id][0].metric)
    return [
        _uncertainty(
            entry, draws, is_fraction, ranking.confidence, draws.headline(headline)[primary]
        )
        for entry, draws in resample(entries, ranking)
    ]


def scene_weights(n_scenes: int, ranking: RankingSection) -> NDArray[np.uint16]:
    """How often each of B draws takes each of S scenes, (S, B); fixed by the protocol's seed."""
    rng = np.random.Generator(np.random.PCG64(ranking.bootstrap_seed))
    weights = np.empty((n_scenes, ranking.bootstrap_draws), dtype=np.uint16)
    for draw in range(ranking.bootstrap_draws):
        taken = rng.integers(0, n_scenes, size=n_scenes)
        weights[:, draw] = np.bincount(taken, minlength=n_scenes)
    return weights


def resample(
    entries: Iterable[SceneSums], ranking: RankingSection
) -> Iterator[tuple[SceneSums, Draws]]:
    """Yield every entry with its draws."""
    weights: NDArray[np.uint16] | None = None
    entries = iter(entries)
    while block := list(islice(entries, BLOCK_ENTRIES)):
        if weights is None:
            weights = scene_weights(len(block[0].sums), ranking)
        yield from zip(block, _totals(block, weights), strict=True)


def _totals(block: list[SceneSums], weights: NDArray[np.uint16]) -> list[Draws]:
    """Weighted sums over scenes; weights become floating point once per block of entries."""
    cells = [_cells_by_scene(entry) for entry in block]
    n_draws = weights.shape[1]
    totals = [np.empty((len(matrix), n_draws)) for matrix, _ in cells]
    for begin in range(0, n_draws, BLOCK_DRAWS):
        part = slice(begin, begin + BLOCK_DRAWS)
        drawn = weights[:, part].astype(np.float64)
        for total, (matrix, _) in zip(totals, cells, strict=True):
            np.matmul(matrix, drawn, out=total[:, part])
    return [
        _means(total, entry.sums.shape[1:], column)
        for total, entry, (_, column) in zip(totals, block, cells, strict=True)
    ]


def _cells_by_scene(entry: SceneSums) -> tuple[FloatArray, IntArray]:
    """Rows (F * M sums, then F * G counts) by scene, and which of the G counts each metric has.

    Metrics that are defined for the same samples share their counts: most entries have one kind.
    """
    n_scenes, _, n_metrics = entry.sums.shape
    counts, column = np.unique(entry.counts.reshape(-1, n_metrics), axis=1, return_inverse=True)
    rows = np.concatenate([entry.sums.reshape(n_scenes, -1), counts.reshape(n_scenes, -1)], axis=1)
    return np.ascontiguousarray(rows.T), column.reshape(-1)


def _means(totals: FloatArray, shape: tuple[int, ...], column: IntArray) -> Draws:
    n_families, n_metrics = shape
    n_draws = totals.shape[1]
    sums = totals[: n_families * n_metrics].reshape(n_families, n_metrics, n_draws)
    counts = totals[n_families * n_metrics :].reshape(n_families, -1, n_draws)
    with np.errstate(invalid="ignore"):  # 0 / 0 is NaN: this draw defines no mean
        families = sums / counts[:, column]
        micro = sums.sum(axis=0) / counts.sum(axis=0)[column]
        defined = counts > 0
        if defined.all():
            return Draws(micro, families.sum(axis=0) / n_families, families)
        macro = np.where(defined[:, column], families, 0).sum(axis=0) / defined.sum(axis=0)[column]
    return Draws(micro, macro, families)


def _uncertainty(
    entry: SceneSums,
    draws: Draws,
    is_fraction: BoolArray,
    confidence: float,
    primary_draws: FloatArray,
) -> Uncertainty:
    of_family = np.count_nonzero(entry.counts, axis=0)
    overall = np.count_nonzero(entry.counts.sum(axis=1), axis=0)

    def intervals(values: FloatArray, n_scenes: IntArray, effective_n: FloatArray) -> FloatArray:
        found = percentile_intervals(values, confidence)
        wilson = wilson_at_the_ends(found, effective_n, confidence)
        found = np.where(is_fraction[:, None], wilson, found)
        return np.where((n_scenes >= FEWEST_SCENES)[..., None], found, np.nan)

    return Uncertainty(
        micro=intervals(draws.micro, overall, overall.astype(np.float64)),
        macro_family=intervals(draws.macro_family, overall, _effective_n(of_family)),
        families=intervals(draws.families, of_family, of_family.astype(np.float64)),
        primary_draws=primary_draws.copy(),
    )


def _effective_n(n_by_family: IntArray) -> FloatArray:
    """Observations that an unweighted mean of F family means is worth: F^2 / sum(1 / n_f), (M,)."""
    present = n_by_family > 0
    harmonic = np.where(present, 1 / np.maximum(n_by_family, 1), 0.0).sum(axis=0)
    worth: FloatArray = present.sum(axis=0) ** 2 / np.where(harmonic > 0, harmonic, 1.0)
    return worth
