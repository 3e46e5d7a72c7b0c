"""Aggregate: sample scores to totals and breakdown, always both aggregates, always labelled.

Sums run in the split's canonical order, so that the same input gives the same bits.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from exceptiondrive_schemas.taxonomy import Taxonomy
from exceptiondrive_scoring.aliases import FloatArray, IntArray
from exceptiondrive_scoring.arrays import SplitArrays
from exceptiondrive_scoring.grade import SampleScores

MetricMeans = dict[str, float | None]


class Row(NamedTuple):
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

    Samples are summed once, by task; families and the total are sums of those. The macro average of
    a metric is taken over the families that define it.
    """
    keys, groups = scores.metric_keys, split.by_task
    tasks = _sums_by_task(scores, split)
    families = _sums_by_family(tasks, groups.family_index, len(taxonomy.families))
    total = _Sums(split.n_samples, tasks.sums.sum(axis=0), tasks.counts.sum(axis=0))
    task_ids = [taxonomy.tasks[index].id for index in groups.task_index]
    return Breakdown(
        n=split.n_samples,
        micro=dict(zip(keys, _plain(total.means()), strict=True)),
        macro_family=dict(zip(keys, _plain(_mean_of_defined(families.means())), strict=True)),
        families=_rows([family.id for family in taxonomy.families], keys, families),
        tasks=_rows(task_ids, keys, tasks),
    )


class _Sums(NamedTuple):
    """Sizes, sums and numbers of defined values; the first axis, if any, is the group."""

    sizes: IntArray | int
    sums: FloatArray
    counts: FloatArray | IntArray

    def means(self) -> FloatArray:
        """NaN where nothing is defined."""
        undefined = np.full(self.sums.shape, np.nan)
        means: FloatArray = np.divide(self.sums, self.counts, out=undefined, where=self.counts > 0)
        return means


def _sums_by_task(scores: SampleScores, split: SplitArrays) -> _Sums:
    groups = split.by_task
    values = scores.values.take(groups.order, 0)
    undefined = np.isnan(values)
    counts = np.broadcast_to(groups.sizes[:, None], (len(groups.sizes), values.shape[1]))
    if undefined.any():
        values[undefined] = 0.0
        counts = counts - np.add.reduceat(undefined, groups.starts, axis=0, dtype=np.intp)
    return _Sums(groups.sizes, np.add.reduceat(values, groups.starts, axis=0), counts)


def _sums_by_family(tasks: _Sums, family_index: IntArray, n_families: int) -> _Sums:
    sizes = np.zeros(n_families, dtype=np.intp)
    sums = np.zeros((n_families, tasks.sums.shape[1]))
    counts = np.zeros(sums.shape, dtype=np.intp)
    np.add.at(sizes, family_index, tasks.sizes)
    np.add.at(sums, family_index, tasks.sums)
    np.add.at(counts, family_index, tasks.counts)
    return _Sums(sizes, sums, counts)


def _mean_of_defined(rows: FloatArray) -> FloatArray:
    """Unweighted mean over the first axis of what is not NaN."""
    defined = ~np.isnan(rows)
    return _Sums(len(rows), np.where(defined, rows, 0.0).sum(axis=0), defined.sum(axis=0)).means()


def _rows(ids: Sequence[str], keys: Sequence[str], groups: _Sums) -> dict[str, Row]:
    rows = zip(ids, np.asarray(groups.sizes).tolist(), _plain(groups.means()), strict=True)
    return {key: Row(n, dict(zip(keys, means, strict=True))) for key, n, means in rows if n}


def _plain(means: FloatArray) -> Any:
    """Python floats, None in place of NaN, nested as the array."""
    plain = means.astype(object)
    plain[np.isnan(means)] = None
    return plain.tolist()
