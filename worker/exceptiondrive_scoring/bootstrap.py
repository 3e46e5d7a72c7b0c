"""Bootstrap over scenes: how far a score would move if other scenes had been drawn.

One scene carries up to 21 samples, so scenes are drawn, not samples (docs/protocol.md section 4).
Draws come from the protocol's seed alone and are the same for every entry: comparisons are paired.

For a metric that is a mean, the draws need only sums by scene and family, rounded to a grid of
2^-30, below 1e-9. Weighted sums of them are then exact in float64 (up to 2^23, far above what a
split can reach), so they do not depend on the order of additions: not on the library, the number of
threads, or which entries are computed together. For a minimum or a quantile, the draws need the
values themselves. Entries are resampled in blocks, which bounds the memory.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from exceptiondrive_schemas.challenges import Challenge, Metric
from exceptiondrive_schemas.protocol import RankingSection
from exceptiondrive_schemas.taxonomy import Taxonomy
from exceptiondrive_scoring.aliases import FloatArray, IntArray
from exceptiondrive_scoring.arrays import SplitArrays
from exceptiondrive_scoring.grade import SampleScores
from exceptiondrive_scoring.interval import (
    draws_cut_off,
    percentile_intervals,
    wilson_at_the_ends,
)
from exceptiondrive_scoring.sheet import order_statistic

GRID = 2.0**-30
SAME_TO = 1e-9
"""Values no further apart than this are equal: the order of arithmetic changes last bits."""


@dataclass(frozen=True)
class SceneSums:
    """Metric values of one entry, summed over the samples of each family and scene.

    Attributes:
        sums: (F, M, S), multiples of `GRID`.
        counts: (F, M, S) number of samples that define the metric.
        values: (N, K) of the K metrics that are no means and so cannot be computed from sums.
        scene_index: (N,).
        group_index: (N,) family.
    """

    sums: FloatArray
    counts: FloatArray
    values: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    scene_index: IntArray = field(default_factory=lambda: np.empty(0, dtype=np.intp))
    group_index: IntArray = field(default_factory=lambda: np.empty(0, dtype=np.intp))


def scene_sums(
    scores: SampleScores, split: SplitArrays, taxonomy: Taxonomy, *, by_task: bool = False
) -> SceneSums:
    """Sum sample scores by scene and family (or task, with `by_task`), in canonical order."""
    group_index = split.task_index if by_task else split.family_index
    n_groups = len(taxonomy.tasks if by_task else taxonomy.families)
    shape = (n_groups, len(scores.metric_keys), split.n_scenes)
    cell = group_index * split.n_scenes + split.scene_index
    defined = scores.defined
    filled = np.where(defined, scores.values, 0.0)
    sums, counts = np.empty(shape), np.empty(shape)
    n_cells = n_groups * split.n_scenes
    for m in range(shape[1]):
        sums[:, m] = np.bincount(cell, filled[:, m], n_cells).reshape(n_groups, -1)
        counts[:, m] = np.bincount(cell, defined[:, m], n_cells).reshape(n_groups, -1)
    ordered = [m for m, metric in enumerate(scores.metrics) if metric.order_level is not None]
    values = scores.values[:, ordered]
    on_grid = np.rint(sums / GRID) * GRID
    return SceneSums(on_grid, counts, values, split.scene_index, group_index)


@dataclass(frozen=True)
class OfAggregates:
    """One quantity of each metric, for both aggregates and for each family.

    Attributes:
        micro: (M, ...).
        macro_family: (M, ...).
        families: (F, M, ...).
    """

    micro: FloatArray
    macro_family: FloatArray
    families: FloatArray

    def headline(self, aggregate: str) -> FloatArray:
        """Return the part of the aggregate with this name, `micro` or `macro_family`."""
        return {"micro": self.micro, "macro_family": self.macro_family}[aggregate]


def scene_counts(entry: SceneSums) -> OfAggregates:
    """Count the scenes that each mean rests on, (M,): those with a sample that defines the metric.

    The unweighted mean of F family means has F^2 / sum(1 / n_f) effective scenes if families are
    independent. But a scene may lie in several families, so the number of scenes is an upper bound.
    """
    occupied = entry.counts > 0
    micro = occupied.any(axis=0).sum(axis=-1, dtype=np.float64)
    families = occupied.sum(axis=-1, dtype=np.float64)
    present = families > 0
    harmonic = np.where(present, 1 / np.maximum(families, 1), 0.0).sum(axis=0)
    worth = present.sum(axis=0) ** 2 / np.where(harmonic > 0, harmonic, 1.0)
    return OfAggregates(micro, np.minimum(worth, micro), families)


def scenes_by_freedom(n_scenes: OfAggregates) -> OfAggregates:
    """Replace the effective scenes of the mean of families by its degrees of freedom plus one.

    By Welch and Satterthwaite they are (sum 1 / n_f)^2 / sum(1 / (n_f^2 (n_f - 1))) if families
    vary alike: a family of few scenes contributes most of the variance, estimated from these few
    alone. A single scene gives no estimate: the mean then has no interval (`fewest_scenes`).
    """
    families = n_scenes.families
    variances = np.divide(1, families, out=np.zeros_like(families), where=families > 0)
    of_each = np.divide(variances**2, families - 1, out=np.zeros_like(families), where=families > 1)
    unsure = of_each.sum(axis=0)
    freedom = np.divide(
        variances.sum(axis=0) ** 2, unsure, out=np.zeros_like(unsure), where=unsure > 0
    )
    return replace(n_scenes, macro_family=np.minimum(1 + freedom, n_scenes.micro))


def fewest_scenes(n_scenes: OfAggregates) -> OfAggregates:
    """Replace the effective scenes of the mean of families by the scenes of its smallest family."""
    families = n_scenes.families
    fewest = np.where(families > 0, families, np.inf).min(axis=0)
    return replace(n_scenes, macro_family=np.minimum(fewest, n_scenes.micro))


def scene_marks(entry: SceneSums) -> OfAggregates:
    """Return what each scene contributes to each aggregate: (M, S), and to families (F, M, S).

    For the mean of families it is a mix of the scene's sums that other sums are unlikely to give.
    """
    weights = 1 / np.sqrt(np.arange(2, 2 + len(entry.sums)))[:, None, None]
    return OfAggregates(entry.sums.sum(axis=0), (entry.sums * weights).sum(axis=0), entry.sums)


BLOCK_DRAWS = 64_000
"""Draws, of all entries of a block together, that are held in memory at once."""


class Draws(OfAggregates):
    """Metric means in each of B draws, (M, B); NaN where a draw holds no sample that defines one."""


@dataclass(frozen=True)
class Uncertainty(OfAggregates):
    """Intervals of one entry, (M, 2): low and high, NaN where undefined.

    Attributes:
        micro: As in `OfAggregates`.
        macro_family: The same.
        families: The same.
        primary_draws: (B,) headline of the metric that ranks first: for `rank_intervals`.
        primary_cut: Number of draws that its interval leaves outside at each end.
        primary_scenes: (S,) `scene_marks` of this metric; equal if within `SAME_TO`.
    """

    primary_draws: FloatArray
    primary_cut: int
    primary_scenes: FloatArray


def bootstrap(
    entries: Iterable[SceneSums], challenge: Challenge, ranking: RankingSection, headline: str
) -> Iterator[Uncertainty]:
    """Yield the intervals of each entry, by metric, for both aggregates and for families.

    Entries are the scene sums of `challenge.interval_metrics` over one split. They are read block
    by block, so a generator saves memory. The headline is `micro` or `macro_family`.
    """
    metrics = challenge.interval_metrics
    primary = [m.key for m in metrics].index(ranking.order_of(challenge)[0].metric)
    is_share = np.array([m.unit == "fraction" and m.order_level is None for m in metrics])

    def intervals(
        values: FloatArray, n: FloatArray, free: FloatArray, fewest: FloatArray
    ) -> FloatArray:
        found = percentile_intervals(values, free, ranking.confidence)
        wilson = wilson_at_the_ends(found, n, ranking.confidence)
        return where_enough(np.where(is_share[:, None], wilson, found), fewest, ranking)

    for entry, draws in resample(entries, ranking, metrics):
        n = scene_counts(entry)
        free, fewest = scenes_by_freedom(n), fewest_scenes(n)
        of_primary = SceneSums(entry.sums[:, [primary]], entry.counts)
        yield Uncertainty(
            micro=intervals(draws.micro, n.micro, free.micro, fewest.micro),
            macro_family=intervals(
                draws.macro_family, n.macro_family, free.macro_family, fewest.macro_family
            ),
            families=intervals(draws.families, n.families, free.families, fewest.families),
            primary_draws=draws.headline(headline)[primary].copy(),
            primary_cut=draws_cut_off(
                ranking.bootstrap_draws,
                ranking.confidence,
                float(free.headline(headline)[primary]),
            ),
            primary_scenes=scene_marks(of_primary).headline(headline)[0].copy(),
        )


def scene_weights(n_scenes: int, ranking: RankingSection) -> NDArray[np.uint16]:
    """Return how often each of B draws takes each of S scenes, (S, B); the seed fixes it."""
    return _scene_weights(n_scenes, ranking.bootstrap_draws, ranking.bootstrap_seed)


@lru_cache(maxsize=2)
def _scene_weights(n_scenes: int, n_draws: int, seed: int) -> NDArray[np.uint16]:
    """Cached: a board compares dozens of pairs on one split. Callers must not write to it."""
    rng = np.random.Generator(np.random.PCG64(seed))
    weights = np.empty((n_scenes, n_draws), dtype=np.uint16)
    for draw in range(n_draws):
        taken = rng.integers(0, n_scenes, size=n_scenes)
        weights[:, draw] = np.bincount(taken, minlength=n_scenes)
    weights.setflags(write=False)
    return weights


def resample(
    entries: Iterable[SceneSums], ranking: RankingSection, metrics: Sequence[Metric]
) -> Iterator[tuple[SceneSums, Draws]]:
    """Yield every entry with its draws; `metrics` are those of the columns of every entry."""
    ordered = [(m, each.order_level) for m, each in enumerate(metrics)]
    levels = [(m, level) for m, level in ordered if level is not None]
    entries = iter(entries)
    weights: NDArray[np.uint16] | None = None
    n_together = max(1, BLOCK_DRAWS // ranking.bootstrap_draws)
    while block := list(islice(entries, n_together)):
        if weights is None:
            weights = scene_weights(block[0].sums.shape[-1], ranking)
        for entry, draws in zip(block, _resample_block(block, weights), strict=True):
            for k, (m, level) in enumerate(levels):
                _draw_order_statistic(draws, m, entry, entry.values[:, k], weights, level)
            yield entry, draws


def _resample_block(block: list[SceneSums], weights: NDArray[np.uint16]) -> list[Draws]:
    n_families, n_metrics, _ = block[0].sums.shape
    n_sums = len(block) * n_metrics
    kinds, kind = _distinct_counts(block)
    totals = np.empty((n_families, n_sums + len(kinds), weights.shape[1]))
    for family in range(n_families):
        scenes = np.flatnonzero(kinds[:, family].any(axis=0))
        sums = [entry.sums[family][:, scenes] for entry in block]
        rows = np.concatenate([*sums, kinds[:, family][:, scenes]])
        np.matmul(rows, weights[scenes].astype(np.float64), out=totals[family])
    counts = totals[:, n_sums:]
    return [
        _means(totals[:, e * n_metrics : (e + 1) * n_metrics], counts, kind[e])
        for e in range(len(block))
    ]


def _draw_order_statistic(
    draws: Draws,
    m: int,
    entry: SceneSums,
    values: FloatArray,
    weights: NDArray[np.uint16],
    level: float,
) -> None:
    """Replace the draws of a metric that is no mean, computed as means, by order statistics."""
    defined = ~np.isnan(values)
    values, scene, group = values[defined], entry.scene_index[defined], entry.group_index[defined]
    draws.micro[m] = order_statistic(values, weights[scene], level)
    for family in range(len(draws.families)):
        member = group == family
        found = order_statistic(values[member], weights[scene[member]], level)
        draws.families[family, m] = found
    families = draws.families[:, m]
    is_there = ~np.isnan(families)
    n_there = is_there.sum(axis=0)
    total = np.where(is_there, families, 0.0).sum(axis=0)
    draws.macro_family[m] = np.where(n_there > 0, total / np.maximum(n_there, 1), np.nan)


def _distinct_counts(block: list[SceneSums]) -> tuple[FloatArray, IntArray]:
    """Return the distinct counts by family and scene, (G, F, S), and which each metric has, (E, M).

    Metrics defined for the same samples share their counts: mostly those of the split itself.
    """
    kinds: dict[bytes, tuple[int, FloatArray]] = {}
    kind: list[int] = []
    for entry in block:
        for counts in entry.counts.swapaxes(0, 1):
            kind.append(kinds.setdefault(counts.tobytes(), (len(kinds), counts))[0])
    different = np.stack([counts for _, counts in kinds.values()])
    return different, np.array(kind).reshape(len(block), -1)


def _means(sums: FloatArray, counts: FloatArray, kind: IntArray) -> Draws:
    """Draws of one entry from its weighted sums, (F, M, B), and all counts, (F, G, B)."""
    defined = counts > 0
    with np.errstate(invalid="ignore"):  # 0 / 0 is NaN: this draw defines no mean
        families = sums / counts[:, kind]
        micro = sums.sum(axis=0) / counts.sum(axis=0)[kind]
        if defined.all():
            return Draws(micro, families.mean(axis=0), families)
        filled = np.where(defined[:, kind], families, 0.0)
        macro = filled.sum(axis=0) / defined.sum(axis=0)[kind]
    return Draws(micro, macro, families)


def where_enough(
    intervals: FloatArray, n_scenes: FloatArray, ranking: RankingSection
) -> FloatArray:
    """Replace intervals that rest on too few scenes by NaN."""
    return np.where((n_scenes >= ranking.min_scenes)[..., None], intervals, np.nan)
