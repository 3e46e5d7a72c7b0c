"""Sums by scene and family: all that the bootstrap needs to know of an entry.

Sums are rounded to a grid of 2^-30, below 1e-9. Weighted sums of them are then exact in float64 (up
to 2^23, far above what a split can reach), so they do not depend on the order of additions: not on
the library, the number of threads, or which entries are computed together.
"""

from dataclasses import dataclass

import numpy as np

from exceptiondrive_schemas.taxonomy import Taxonomy
from exceptiondrive_scoring.aliases import FloatArray, IntArray
from exceptiondrive_scoring.arrays import SplitArrays
from exceptiondrive_scoring.grade import SampleScores

GRID = 2.0**-30


@dataclass(frozen=True)
class SceneSums:
    """Metric values of one entry, summed over the samples of each scene and family.

    Attributes:
        sums: (S, F, M), multiples of `GRID`.
        counts: (S, F, M) number of samples that define the metric.
    """

    sums: FloatArray
    counts: FloatArray


def scene_sums(scores: SampleScores, split: SplitArrays, taxonomy: Taxonomy) -> SceneSums:
    """Sum sample scores by scene and family, in canonical order."""
    return _sums_by(scores, split, split.family_index, len(taxonomy.families))


def scene_sums_by_task(scores: SampleScores, split: SplitArrays, taxonomy: Taxonomy) -> SceneSums:
    """Sum sample scores by scene and task: tasks stand where else families do."""
    return _sums_by(scores, split, split.task_index, len(taxonomy.tasks))


def _sums_by(
    scores: SampleScores, split: SplitArrays, group_index: IntArray, n_groups: int
) -> SceneSums:
    shape = (split.n_scenes, n_groups, len(scores.metric_keys))
    cell = split.scene_index * n_groups + group_index
    defined = scores.defined
    filled = np.where(defined, scores.values, 0.0)
    sums, counts = np.empty(shape), np.empty(shape)
    n_cells = shape[0] * shape[1]
    for m in range(shape[2]):
        sums[..., m] = np.bincount(cell, filled[:, m], n_cells).reshape(shape[:2])
        counts[..., m] = np.bincount(cell, defined[:, m], n_cells).reshape(shape[:2])
    return SceneSums(np.rint(sums / GRID) * GRID, counts)


@dataclass(frozen=True)
class SceneCounts:
    """Scenes that a mean rests on: those with a sample that defines the metric.

    Attributes:
        micro: (M,).
        macro_family: (M,) scenes that the unweighted mean of F family means is worth:
            F^2 / sum(1 / n_f) for independent families. But a scene may lie in several families, so
            it is never worth more than there are scenes.
        families: (F, M).
    """

    micro: FloatArray
    macro_family: FloatArray
    families: FloatArray

    def headline(self, aggregate: str) -> FloatArray:
        """Scenes of the aggregate with this name, `micro` or `macro_family`."""
        return {"micro": self.micro, "macro_family": self.macro_family}[aggregate]


def scene_counts(entry: SceneSums) -> SceneCounts:
    """Count the scenes that the means of an entry rest on."""
    occupied = entry.counts > 0
    micro = occupied.any(axis=1).sum(axis=0, dtype=np.float64)
    families = occupied.sum(axis=0, dtype=np.float64)
    present = families > 0
    harmonic = np.where(present, 1 / np.maximum(families, 1), 0.0).sum(axis=0)
    worth = present.sum(axis=0) ** 2 / np.where(harmonic > 0, harmonic, 1.0)
    return SceneCounts(micro, np.minimum(worth, micro), families)
