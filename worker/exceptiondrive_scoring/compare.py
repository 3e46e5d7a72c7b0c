"""Compare two entries on the same samples and the same draws: what a board cannot show alone."""

from dataclasses import dataclass

import numpy as np

from exceptiondrive_schemas.challenges import Challenge, Metric
from exceptiondrive_schemas.protocol import Protocol
from exceptiondrive_scoring.aliases import FloatArray
from exceptiondrive_scoring.arrays import SplitArrays
from exceptiondrive_scoring.bootstrap import resample, where_enough
from exceptiondrive_scoring.grade import SampleScores
from exceptiondrive_scoring.interval import percentile_intervals
from exceptiondrive_scoring.scene_sums import scene_counts, scene_sums, scene_sums_by_task
from exceptiondrive_scoring.sheet import aggregate

Interval = tuple[float, float]
NOT_SEPARABLE = "not separable on this split"


@dataclass(frozen=True)
class Difference:
    """A minus B in one metric, over the samples that both define.

    Attributes:
        difference: Difference of the means; None where nothing is defined.
        interval: Its bootstrap interval over scenes; None with fewer than two scenes.
        discordant: Share of the samples in which the two values differ.
        verdict: Plain words.
    """

    difference: float | None
    interval: Interval | None
    discordant: float | None
    verdict: str


@dataclass(frozen=True)
class Comparison:
    """Differences by metric key: the headline aggregate, each family and each task with samples.

    Tasks carry the challenge's first metric alone.
    """

    overall: dict[str, Difference]
    families: dict[str, dict[str, Difference]]
    tasks: dict[str, dict[str, Difference]]


def compare(
    a: SampleScores, b: SampleScores, split: SplitArrays, protocol: Protocol, challenge: Challenge
) -> Comparison:
    """Compare entry A with entry B, paired by sample.

    Args:
        a: Sample scores of A.
        b: Sample scores of B on the same split.
        split: The split of both.
        protocol: Headline aggregate, draws, seed, confidence.
        challenge: Which way each metric is better.
    """
    headline, taxonomy = protocol.grading.headline, protocol.taxonomy
    difference = SampleScores(a.metric_keys, a.values - b.values)
    differs = np.where(difference.defined, (difference.values != 0).astype(np.float64), np.nan)
    means = aggregate(difference, split, taxonomy)
    discordant = aggregate(SampleScores(a.metric_keys, differs), split, taxonomy)
    sums = scene_sums(difference, split, taxonomy)
    ((_, draws),) = resample([sums], protocol.ranking)
    confidence = protocol.ranking.confidence
    n_scenes = scene_counts(sums)

    def intervals(values: FloatArray, n: FloatArray) -> FloatArray:
        return where_enough(percentile_intervals(values, n, confidence), n)

    overall = intervals(draws.headline(headline), n_scenes.headline(headline))
    by_family = intervals(draws.families, n_scenes.families)
    return Comparison(
        overall=_differences(challenge, means.headline(headline), discordant.micro, overall),
        families={
            family.id: _differences(
                challenge,
                means.families[family.id].metrics,
                discordant.families[family.id].metrics,
                by_family[index],
            )
            for index, family in enumerate(taxonomy.families)
            if family.id in means.families
        },
        tasks=_by_task(difference, split, protocol, challenge),
    )


def _by_task(
    difference: SampleScores, split: SplitArrays, protocol: Protocol, challenge: Challenge
) -> dict[str, dict[str, Difference]]:
    """Differences of the first metric by task; the same draws of scenes as everything else."""
    taxonomy, first = protocol.taxonomy, challenge.metrics[0]
    column = difference.metric_keys.index(first.key)
    alone = SampleScores((first.key,), difference.values[:, column : column + 1])
    differs = np.where(alone.defined, (alone.values != 0).astype(np.float64), np.nan)
    means = aggregate(alone, split, taxonomy).tasks
    discordant = aggregate(SampleScores(alone.metric_keys, differs), split, taxonomy).tasks
    sums = scene_sums_by_task(alone, split, taxonomy)
    ((_, draws),) = resample([sums], protocol.ranking)
    n = scene_counts(sums).families
    found = percentile_intervals(draws.families, n, protocol.ranking.confidence)
    intervals = where_enough(found, n)
    return {
        task.id: {
            first.key: _difference(
                first,
                means[task.id].metrics[first.key],
                discordant[task.id].metrics[first.key],
                intervals[index][0],
            )
        }
        for index, task in enumerate(taxonomy.tasks)
        if task.id in means
    }


def _differences(
    challenge: Challenge,
    means: dict[str, float | None],
    discordant: dict[str, float | None],
    intervals: FloatArray,
) -> dict[str, Difference]:
    return {
        metric.key: _difference(metric, means[metric.key], discordant[metric.key], ends)
        for metric, ends in zip(challenge.metrics, intervals, strict=True)
    }


def _difference(
    metric: Metric, mean: float | None, discordant: float | None, ends: FloatArray
) -> Difference:
    if mean is None or np.isnan(ends).any():
        return Difference(mean, None, discordant, NOT_SEPARABLE)
    interval = (float(ends[0]), float(ends[1]))
    return Difference(mean, interval, discordant, _verdict(metric, *interval))


def _verdict(metric: Metric, low: float, high: float) -> str:
    if low <= 0 <= high:
        return NOT_SEPARABLE
    larger, smaller = ("A", "B") if low > 0 else ("B", "A")
    if metric.better is None:
        return f"{larger} is higher"
    return f"{larger if metric.better == 'higher' else smaller} is better"
