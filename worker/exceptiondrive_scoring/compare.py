"""Compare two entries on the same samples and the same draws, which a board alone cannot show."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from exceptiondrive_schemas.board import PairedComparison
from exceptiondrive_schemas.challenges import Challenge, Metric
from exceptiondrive_schemas.protocol import ProtocolDocument, RankingSection
from exceptiondrive_schemas.score_sheet import PairedDifference
from exceptiondrive_schemas.taxonomy import Family, Task
from exceptiondrive_scoring.aliases import BoolArray, FloatArray
from exceptiondrive_scoring.arrays import SplitArrays
from exceptiondrive_scoring.bootstrap import (
    SAME_TO,
    Draws,
    OfAggregates,
    SceneSums,
    fewest_scenes,
    resample,
    scene_counts,
    scene_marks,
    scene_sums,
    scenes_by_freedom,
    where_enough,
)
from exceptiondrive_scoring.grade import SampleScores
from exceptiondrive_scoring.interval import least_differing, percentile_intervals
from exceptiondrive_scoring.sheet import Breakdown, MetricValues, aggregate

AS_MEAN = {"aggregation": "mean", "level": None}
NOT_SEPARABLE = "not separable on this split"
NO_INTERVAL = "no interval"
LEAST_DEFINED = 0.5
"""Share of the samples of each family that both entries must define: a file that defines a single
sample could otherwise read another team's value there from the difference."""


def compare(
    a: SampleScores,
    b: SampleScores,
    split: SplitArrays,
    protocol: ProtocolDocument,
    challenge: Challenge,
) -> PairedComparison:
    """Compare entry A with entry B on the split of both, paired by sample; nothing is rounded.

    A difference is None where both define less than `LEAST_DEFINED` of a family. Samples that differ
    by more than `SAME_TO` are discordant. Families and tasks without samples are left out.
    """
    headline, taxonomy = protocol.grading.headline, protocol.taxonomy
    metrics = challenge.interval_metrics
    a, b = a.only(metrics), b.only(metrics)
    paired = _paired_differences(a, b, split, protocol)
    by_task = _paired_differences(
        a.only(metrics[:1]), b.only(metrics[:1]), split, protocol, by_task=True
    )
    means, discordant = paired.values.headline(headline), paired.discordant.micro
    return PairedComparison(
        a="A",
        b="B",
        overall={
            metric.key: _difference(metric, means[metric.key], discordant[metric.key], ends)
            for metric, ends in zip(metrics, paired.intervals(headline), strict=True)
        },
        families=_by_group(metrics[0], paired, "families", taxonomy.families),
        tasks=_by_group(metrics[0], by_task, "tasks", taxonomy.tasks),
    )


@dataclass(frozen=True)
class _Paired:
    """A minus B: over all samples and groups, and in each draw.

    Draws, and the scenes that they rest on, are by family or by the other grouping of the sums.
    """

    values: Breakdown
    discordant: Breakdown
    draws: Draws
    n_scenes: OfAggregates
    n_differing: OfAggregates
    ranking: RankingSection

    def intervals(self, of: str) -> FloatArray:
        """Return the intervals of an aggregate, or of the families.

        They rest on the scenes that differ, since the others do not show which entry is better. If
        too few differ, intervals are extended to 0, the value of a draw that contains none of them.
        """
        confidence, n_differing = self.ranking.confidence, getattr(self.n_differing, of)
        n = np.minimum(getattr(scenes_by_freedom(self.n_scenes), of), n_differing)
        found = percentile_intervals(getattr(self.draws, of), n, confidence)
        is_open = n_differing < least_differing(confidence)
        found[..., 0] = np.where(is_open, np.minimum(found[..., 0], 0), found[..., 0])
        found[..., 1] = np.where(is_open, np.maximum(found[..., 1], 0), found[..., 1])
        return where_enough(found, getattr(fewest_scenes(self.n_scenes), of), self.ranking)


def _paired_differences(
    a: SampleScores,
    b: SampleScores,
    split: SplitArrays,
    protocol: ProtocolDocument,
    *,
    by_task: bool = False,
) -> _Paired:
    """Return the differences over the samples that both define.

    The difference of two means is the mean of the differences; of two minima or quantiles it is the
    difference of the two.
    """
    taxonomy, ranking = protocol.taxonomy, protocol.ranking
    gaps = a.values - b.values
    gaps[:, ~_are_compared(gaps, split)] = np.nan
    differs = np.where(np.isnan(gaps), np.nan, (np.abs(gaps) > SAME_TO).astype(np.float64))
    means = tuple(metric.model_copy(update=AS_MEAN) for metric in a.metrics)
    values = aggregate(SampleScores(means, gaps), split, taxonomy)
    sums = scene_sums(SampleScores(means, gaps), split, taxonomy, by_task=by_task)
    ((_, draws),) = resample([sums], ranking, means)
    columns = [m for m, metric in enumerate(a.metrics) if metric.order_level is not None]
    if columns:
        ordered = tuple(a.metrics[m] for m in columns)
        both = [np.where(np.isnan(gaps), np.nan, each.values)[:, columns] for each in (a, b)]
        sides = [SampleScores(ordered, each) for each in both]
        values = _with_differences(values, *(aggregate(side, split, taxonomy) for side in sides))
        of_sides = [scene_sums(side, split, taxonomy, by_task=by_task) for side in sides]
        (_, of_a), (_, of_b) = resample(of_sides, ranking, ordered)
        draws.micro[columns] = of_a.micro - of_b.micro
        draws.macro_family[columns] = of_a.macro_family - of_b.macro_family
        draws.families[:, columns] = of_a.families - of_b.families
    return _Paired(
        values=values,
        discordant=aggregate(SampleScores(means, differs), split, taxonomy),
        draws=draws,
        n_scenes=scene_counts(sums),
        n_differing=scenes_that_differ(sums),
        ranking=ranking,
    )


def scenes_that_differ(gaps: SceneSums) -> OfAggregates:
    """Count the scenes in which two entries differ, from the sums of the gaps between them."""
    marks = scene_marks(gaps)

    def count(of: FloatArray) -> FloatArray:
        n: FloatArray = (np.abs(of) > SAME_TO).sum(axis=-1, dtype=np.float64)
        return n

    return OfAggregates(count(marks.micro), count(marks.macro_family), count(marks.families))


def _are_compared(gaps: FloatArray, split: SplitArrays) -> BoolArray:
    """Whether both define each metric in enough samples of each family; (M,)."""
    defined = ~np.isnan(gaps)
    if defined.all():
        return np.ones(gaps.shape[1], np.bool_)
    families = [defined[split.family_index == family] for family in np.unique(split.family_index)]
    enough: BoolArray = np.all([each.mean(axis=0) >= LEAST_DEFINED for each in families], axis=0)
    return enough


def _with_differences(values: Breakdown, a: Breakdown, b: Breakdown) -> Breakdown:
    """Replace the metrics of a breakdown by the differences between A and B."""

    def row(old: MetricValues, of_a: MetricValues, of_b: MetricValues) -> MetricValues:
        pairs = ((key, value, of_b[key]) for key, value in of_a.items())
        return old | {k: None if x is None or y is None else x - y for k, x, y in pairs}

    def rows(group: str) -> dict[str, MetricValues]:
        old, of_a, of_b = (getattr(each, group) for each in (values, a, b))
        return {key: row(each, of_a[key], of_b[key]) for key, each in old.items()}

    return replace(
        values,
        micro=row(values.micro, a.micro, b.micro),
        macro_family=row(values.macro_family, a.macro_family, b.macro_family),
        families=rows("families"),
        tasks=rows("tasks"),
    )


def _by_group(
    metric: Metric, paired: _Paired, kind: str, groups: Sequence[Family | Task]
) -> dict[str, PairedDifference]:
    """Differences in the first metric by family or by task, from the same draws of scenes."""
    means, discordant = getattr(paired.values, kind), getattr(paired.discordant, kind)
    return {
        group.id: _difference(
            metric, means[group.id][metric.key], discordant[group.id][metric.key], ends[0]
        )
        for group, ends in zip(groups, paired.intervals("families"), strict=True)
        if group.id in means
    }


def _difference(
    metric: Metric, mean: float | None, discordant: float | None, ends: FloatArray
) -> PairedDifference:
    low, high = ends.tolist()
    has_none = math.isnan(low) or math.isnan(high)
    return PairedDifference(
        difference=mean,
        interval=None if has_none else (low, high),
        discordant=discordant,
        verdict=NO_INTERVAL if has_none else _verdict(metric, low, high),
    )


def _verdict(metric: Metric, low: float, high: float) -> str:
    if low <= 0 <= high:
        return NOT_SEPARABLE
    larger, smaller = ("A", "B") if low > 0 else ("B", "A")
    if metric.better is None:
        return f"{larger} is higher"
    return f"{larger if metric.better == 'higher' else smaller} is better"
