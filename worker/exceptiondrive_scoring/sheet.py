"""Aggregate: sample scores to totals and breakdown, always both aggregates, always labelled.

Sums run in the split's canonical order, so that the same input gives the same bits.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from exceptiondrive_schemas.taxonomy import Taxonomy
from exceptiondrive_scoring.aliases import FloatArray, IntArray
from exceptiondrive_scoring.arrays import SplitArrays
from exceptiondrive_scoring.grade import SampleScores

MetricMeans = dict[str, float | None]


@dataclass(frozen=True)
class Row:
    """Mean of each metric over n samples; None where no sample defines it."""

    n: int
    metrics: MetricMeans


@dataclass(frozen=True)
class Breakdown:
    """What may be published, unrounded.

    Attributes:
        n: Samples of the split; missing trajectories count.
        micro: Mean over the samples: the paper's equations.
        macro_family: Unweighted mean of the family means: what the paper's tables print.
        families: Families that have samples, in taxonomy order.
        tasks: Tasks that have samples, in taxonomy order.
    """

    n: int
    micro: MetricMeans
    macro_family: MetricMeans
    families: dict[str, Row]
    tasks: dict[str, Row]

    def headline(self, aggregate: str) -> MetricMeans:
        """Means of the aggregate with this name, `micro` or `macro_family`."""
        return {"micro": self.micro, "macro_family": self.macro_family}[aggregate]


def aggregate(scores: SampleScores, split: SplitArrays, taxonomy: Taxonomy) -> Breakdown:
    """Totals, families and tasks of one submission (PROTOCOL.md section 3).

    The macro average of a metric is taken over the families that define it.
    """
    keys = scores.metric_keys
    whole = np.zeros(split.n_samples, dtype=np.intp)
    by_task = _group_means(scores, split.task_index, len(taxonomy.tasks))
    by_family = _group_means(scores, split.family_index, len(taxonomy.families))
    return Breakdown(
        n=split.n_samples,
        micro=_named(keys, _group_means(scores, whole, 1)[0]),
        macro_family=_named(keys, mean_of_defined(by_family)),
        families=_rows([f.id for f in taxonomy.families], keys, split.family_index, by_family),
        tasks=_rows([task.id for task in taxonomy.tasks], keys, split.task_index, by_task),
    )


def mean_of_defined(rows: FloatArray) -> FloatArray:
    """Unweighted mean over the first axis of what is not NaN; NaN where nothing is."""
    defined = ~np.isnan(rows)
    return _divide(np.where(defined, rows, 0.0).sum(axis=0), defined.sum(axis=0))


def _group_means(scores: SampleScores, group: IntArray, n_groups: int) -> FloatArray:
    """(n_groups, M) means over the samples that define the metric."""
    defined = scores.defined
    filled = np.where(defined, scores.values, 0.0)
    columns = range(filled.shape[1])
    sums = [np.bincount(group, weights=filled[:, m], minlength=n_groups) for m in columns]
    counts = [np.bincount(group, weights=defined[:, m], minlength=n_groups) for m in columns]
    return _divide(np.stack(sums, axis=1), np.stack(counts, axis=1))


def _divide(sums: FloatArray, counts: FloatArray | IntArray) -> FloatArray:
    means: FloatArray = np.divide(sums, counts, out=np.full(sums.shape, np.nan), where=counts > 0)
    return means


def _rows(
    ids: Sequence[str], keys: Sequence[str], group: IntArray, means: FloatArray
) -> dict[str, Row]:
    sizes = np.bincount(group, minlength=len(ids))
    return {
        key: Row(int(sizes[index]), _named(keys, means[index]))
        for index, key in enumerate(ids)
        if sizes[index]
    }


def _named(keys: Sequence[str], means: FloatArray) -> MetricMeans:
    return {
        key: None if np.isnan(mean) else float(mean) for key, mean in zip(keys, means, strict=True)
    }
