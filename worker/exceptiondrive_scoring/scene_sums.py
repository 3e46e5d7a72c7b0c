"""Sums by scene and family: all that the bootstrap needs to know of an entry."""

from dataclasses import dataclass

import numpy as np

from exceptiondrive_schemas.taxonomy import Taxonomy
from exceptiondrive_scoring.aliases import FloatArray
from exceptiondrive_scoring.arrays import SplitArrays
from exceptiondrive_scoring.grade import SampleScores


@dataclass(frozen=True)
class SceneSums:
    """Metric values of one entry, summed over the samples of each scene and family.

    Attributes:
        sums: (S, F, M).
        counts: (S, F, M) number of samples that define the metric.
    """

    sums: FloatArray
    counts: FloatArray


def scene_sums(scores: SampleScores, split: SplitArrays, taxonomy: Taxonomy) -> SceneSums:
    """Sum sample scores by scene and family, in canonical order."""
    n_families = len(taxonomy.families)
    shape = (split.n_scenes, n_families, len(scores.metric_keys))
    cell = split.scene_index * n_families + split.family_index
    defined = scores.defined
    filled = np.where(defined, scores.values, 0.0)
    sums, counts = np.empty(shape), np.empty(shape)
    n_cells = shape[0] * shape[1]
    for m in range(shape[2]):
        sums[..., m] = np.bincount(cell, filled[:, m], n_cells).reshape(shape[:2])
        counts[..., m] = np.bincount(cell, defined[:, m], n_cells).reshape(shape[:2])
    return SceneSums(sums, counts)
