"""Aggregate: sample scores to totals and breakdown, always both aggregates, always labelled.

Sums run in the split's canonical order, so that the same input gives the same bits.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import repeat
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exceptiondrive_schemas.challenges import Metric
from exceptiondrive_schemas.taxonomy import Taxonomy
from exceptiondrive_scoring.aliases import FloatArray, IntArray
from exceptiondrive_scoring.arrays import SplitArrays
from exceptiondrive_scoring.grade import SampleScores

ROUNDING = 1e-9
"""Tolerance: a share of 0.1 of 30 samples is 3 of them, whatever the last bits of the product."""
MetricValues = dict[str, float | None]
"""Value of each metric over some samples; None where no sample defines it."""


@dataclass(frozen=True)
class Breakdown:
    """What may be published, unrounded.

    Attributes:
        n: Samples of the split; missing trajectories count.
        micro: Over all samples: the paper's equations.
        macro_family: Unweighted mean of the families' values: what the paper's tables print.
        families: Metrics of the families that have samples, in taxonomy order.
        tasks: Metrics of the tasks that have samples, family by family.
        family_sizes: Number of samples of each of those families.
        task_sizes: Number of samples of each of those tasks.
    """

    n: int
    micro: MetricValues
    macro_family: MetricValues
    families: dict[str, MetricValues]
    tasks: dict[str, MetricValues]
    family_sizes: dict[str, int]
    task_sizes: dict[str, int]

    def headline(self, aggregate: str) -> MetricValues:
        """Values of the aggregate with this name, `micro` or `macro_family`."""
        return {"micro": self.micro, "macro_family": self.macro_family}[aggregate]


def aggregate(scores: SampleScores, split: SplitArrays, taxonomy: Taxonomy) -> Breakdown:
    """Totals, families and tasks of one submission (docs/protocol.md section 3).

    The macro average of a metric is taken over the families that define it.
    """
    return breakdown(scores.metrics, group_means(scores, split), split, taxonomy)


def group_means(scores: SampleScores, split: SplitArrays) -> FloatArray:
    """Values of each metric by group, unrounded.

    Samples are summed once, by task; families and the total are sums of those. A metric that is no
    mean is computed from the samples of each group.

    Returns:
        (R, M), NaN where undefined: rows of the families with samples, of their tasks, of all
        samples, and of the mean of the families.
    """
    groups = split.by_task
    values = scores.values.T
    if groups.order is not None:
        values = values.take(groups.order, 1, mode="clip")  # indices are always in range
    of_tasks = np.add.reduceat(values, groups.starts, axis=1)
    counts: NDArray[Any] = groups.sizes
    if np.isnan(of_tasks).any():
        undefined = np.isnan(values)
        values = np.where(undefined, 0.0, values)
        of_tasks = np.add.reduceat(values, groups.starts, axis=1)
        missing = np.add.reduceat(undefined, groups.starts, axis=1, dtype=np.intp)
        counts = _nan_for_zero(counts - groups.with_totals(missing))
    of_groups = groups.with_totals(of_tasks)
    of_groups /= counts
    for m, metric in enumerate(scores.metrics):
        if metric.order_level is not None:
            of_groups[m] = _order_statistics(scores.values[:, m], metric.order_level, split)
    mean_of_families = _mean_of_defined(of_groups[:, : len(groups.family_index)])
    return np.concatenate([of_groups, mean_of_families], axis=1).T


def breakdown(
    metrics: Sequence[Metric], means: FloatArray, split: SplitArrays, taxonomy: Taxonomy
) -> Breakdown:
    """Label the results of `group_means` for these metrics."""
    keys, groups = [metric.key for metric in metrics], split.by_task
    *rows, micro, macro_family = map(dict, map(zip, repeat(keys), _plain(means)))
    *sizes, n = groups.sizes.tolist()
    families = [taxonomy.families[index].id for index in groups.family_index.tolist()]
    tasks = [taxonomy.tasks[index].id for index in groups.task_index.tolist()]
    of_families, of_tasks = slice(len(families)), slice(len(families), None)
    return Breakdown(
        n=n,
        micro=micro,
        macro_family=macro_family,
        families=dict(zip(families, rows[of_families], strict=True)),
        tasks=dict(zip(tasks, rows[of_tasks], strict=True)),
        family_sizes=dict(zip(families, sizes[of_families], strict=True)),
        task_sizes=dict(zip(tasks, sizes[of_tasks], strict=True)),
    )


def order_statistic(values: FloatArray, weights: IntArray, level: float) -> FloatArray:
    """Return the least value with weight up to which at least a share `level` of the weight lies.

    Args:
        values: (n,), none of them NaN.
        weights: (n, B), how often each value counts.
        level: 0 for the minimum, 0.5 for the median, 1 for the maximum.

    Returns:
        (B,), NaN without any weight.
    """
    if not len(values):
        return np.full(weights.shape[1], np.nan)
    order = np.argsort(values, kind="stable")
    reached = weights[order].cumsum(axis=0, dtype=np.int64)
    needed = np.maximum(np.ceil(reached[-1] * level - ROUNDING), 1)
    found: FloatArray = values[order][(reached >= needed).argmax(axis=0)]
    return np.where(reached[-1] > 0, found, np.nan)


def _order_statistics(values: FloatArray, level: float, split: SplitArrays) -> list[float]:
    """Return a metric by family, by task, and over all, in the order of `aggregate`."""
    groups, defined = split.by_task, ~np.isnan(values)
    members = [
        *(split.family_index == index for index in groups.family_index),
        *(split.task_index == index for index in groups.task_index),
        np.ones_like(defined),
    ]
    chosen = (values[defined & member] for member in members)
    each_once = ((part, np.ones((len(part), 1), dtype=np.intp)) for part in chosen)
    return [float(order_statistic(*part, level)[0]) for part in each_once]


def _mean_of_defined(values: FloatArray) -> FloatArray:
    """Return the unweighted mean over the last axis, without NaN: (M, F) to (M, 1)."""
    undefined = np.isnan(values)
    n: Any = values.shape[1]
    if undefined.any():
        values = np.where(undefined, 0.0, values)
        n = _nan_for_zero(n - undefined.sum(axis=1, keepdims=True))
    mean: FloatArray = values.sum(axis=1, keepdims=True) / n
    return mean


def _nan_for_zero(counts: IntArray) -> FloatArray:
    """Return divisors of sums; zero becomes NaN, so that empty means are NaN without a warning."""
    return np.where(counts, counts, np.nan)


def _plain(means: FloatArray) -> Any:
    """Return Python floats nested as the array, with None for NaN."""
    plain = means.astype(object)
    plain[np.isnan(means)] = None
    return plain.tolist()
