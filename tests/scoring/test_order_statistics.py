"""Metrics that are no means: minimum and quantile, from the sheet to the comparison."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from exceptiondrive_schemas.challenges import PLANNING, Challenge, Metric
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_scoring.aliases import FloatArray
from exceptiondrive_scoring.arrays import SplitArrays
from exceptiondrive_scoring.bootstrap import (
    bootstrap,
    resample,
    scene_sums,
    scene_weights,
)
from exceptiondrive_scoring.compare import compare
from exceptiondrive_scoring.grade import SampleScores
from exceptiondrive_scoring.sheet import aggregate, order_statistic

N, SCENES = 300, 60
HCC = PLANNING.metric("hcc")


def metric(aggregation: Any, level: float | None = None) -> Metric:
    return Metric(
        key=aggregation,
        label="d",
        title="Clearance",
        unit="metre",
        better="higher",
        role="diagnostic",
        meaning="Distance.",
        aggregation=aggregation,
        level=level,
    )


METRICS = (HCC, metric("minimum"), metric("quantile", 0.1), metric("mean"), metric("share"))


def toy(metrics: tuple[Metric, ...]) -> Challenge:
    return Challenge.model_construct(**{**dict(PLANNING), "metrics": metrics})


TOY = toy(METRICS)


@pytest.fixture
def split(make_split: Callable[..., SplitArrays]) -> SplitArrays:
    tasks = np.random.default_rng(5).integers(0, 21, N).tolist()
    scenes = (np.arange(N) % SCENES).tolist()
    return make_split(np.zeros((N, 4, 2)), tasks=tasks, scenes=scenes)


def scores(seed: int, *, missing: float = 0.05, more: float = 0.0) -> SampleScores:
    rng = np.random.default_rng(seed)
    hcc, clearance = rng.random(N), rng.gamma(2.0, 1.0, N) + more
    clearance[rng.random(N) < missing] = np.nan
    return SampleScores(METRICS, np.column_stack([hcc, *[clearance] * 3, clearance > 1]))


def least(values: FloatArray, level: float) -> float:
    """The definition, value by value."""
    defined = sorted(value for value in values.tolist() if value == value)  # noqa: PLR0124
    enough = (v for at, v in enumerate(defined, 1) if at >= level * len(defined) - 1e-9)
    return next(enough, float("nan"))


@pytest.mark.parametrize(("key", "level"), [("minimum", 0.0), ("quantile", 0.1)])
def test_a_sheet_takes_it_from_the_samples_of_each_group(
    split: SplitArrays, protocol: ProtocolDocument, key: str, level: float
) -> None:
    graded = scores(1)
    column = graded.values[:, graded.metric_keys.index(key)]
    sheet = aggregate(graded, split, protocol.taxonomy)
    assert sheet.micro[key] == least(column, level)
    for index, family in enumerate(protocol.families):
        found = sheet.families[family.id][key]
        assert found == least(column[split.family_index == index], level)
    for index, task in enumerate(protocol.tasks):
        assert sheet.tasks[task.id][key] == least(column[split.task_index == index], level)
    values = [row[key] or 0.0 for row in sheet.families.values()]
    assert sheet.macro_family[key] == pytest.approx(np.mean(values))


def test_means_beside_it_stay_to_the_last_bit(
    split: SplitArrays, protocol: ProtocolDocument
) -> None:
    whole, (alone,) = scores(1), METRICS[:1]
    sheet = aggregate(whole, split, protocol.taxonomy)
    of_one = aggregate(SampleScores((alone,), whole.values[:, :1]), split, protocol.taxonomy)
    assert sheet.macro_family["hcc"] == of_one.macro_family["hcc"]
    pair = [SampleScores((alone,), whole.values[:, :1]), whole]
    sums = [scene_sums(each, split, protocol.taxonomy) for each in pair]
    ((_, few),), ((_, all_),) = (
        list(resample([each], protocol.ranking, of.metrics))
        for each, of in zip(sums, pair, strict=True)
    )
    assert (few.families[:, 0] == all_.families[:, 0]).all()


def test_nothing_defined_is_undefined(split: SplitArrays, protocol: ProtocolDocument) -> None:
    sheet = aggregate(scores(1, missing=1.0), split, protocol.taxonomy)
    assert sheet.micro["minimum"] is sheet.macro_family["quantile"] is None


@pytest.mark.parametrize("level", [0.0, 0.1, 0.5, 1.0])
def test_draws_are_the_statistic_of_the_drawn_samples(level: float) -> None:
    rng = np.random.default_rng(3)
    values, weights = rng.random(40), rng.integers(0, 3, (40, 25))
    weights[:, 0] = 0
    found = order_statistic(values, weights, level)
    assert np.isnan(found[0])
    for draw in range(1, 25):
        assert found[draw] == least(np.repeat(values, weights[:, draw]), level)


def test_intervals_come_from_draws_of_scenes(
    split: SplitArrays, protocol: ProtocolDocument
) -> None:
    graded = scores(2)
    graded.values[(split.family_index == 5) & (split.scene_index != 3), 2] = np.nan
    sums = scene_sums(graded, split, protocol.taxonomy)
    ((_, draws),) = resample([sums], protocol.ranking, METRICS)
    weights = scene_weights(SCENES, protocol.ranking)
    without_scene_3 = np.flatnonzero(weights[3] == 0)[0]
    drawn = np.repeat(np.arange(N), weights[split.scene_index, without_scene_3])
    values, family = graded.values[drawn, 2], split.family_index[drawn]
    of_families = [least(values[family == index], 0.1) for index in range(6)]
    assert draws.micro[2, without_scene_3] == least(values, 0.1)
    np.testing.assert_array_equal(draws.families[:, 2, without_scene_3], of_families)
    assert np.isnan(of_families[5])
    assert draws.macro_family[2, without_scene_3] == pytest.approx(np.mean(of_families[:5]))
    (sure,) = bootstrap([sums], TOY, protocol.ranking, "micro")
    value = aggregate(graded, split, protocol.taxonomy).micro
    for m in (1, 2, 3, 4):
        low, high = sure.micro[m]
        assert low <= (value[METRICS[m].key] or 0.0) <= high
    assert sure.micro[1, 0] == value["minimum"]  # no draw goes below the least of all


def test_the_difference_of_two_minima_is_no_minimum_of_differences(
    split: SplitArrays, protocol: ProtocolDocument
) -> None:
    a, b = scores(3, more=0.5), scores(4)
    both = ~np.isnan(a.values[:, 1] - b.values[:, 1])
    found = compare(a, b, split, protocol, TOY)
    headline = protocol.grading.headline
    sides = [SampleScores(METRICS, np.where(both[:, None], s.values, np.nan)) for s in (a, b)]
    of_a, of_b = (aggregate(side, split, protocol.taxonomy).headline(headline) for side in sides)
    for key in ("minimum", "quantile"):
        expected = (of_a[key] or 0.0) - (of_b[key] or 0.0)
        assert found.overall[key].difference == pytest.approx(expected)
        assert found.overall[key].interval is not None
    assert found.overall["quantile"].verdict == "A is better"
    again = compare(a, a, split, protocol, TOY).overall["minimum"]
    assert (again.difference, again.interval, again.discordant) == (0.0, (0.0, 0.0), 0.0)


@pytest.mark.parametrize("headline", ["micro", "macro_family"])
def test_its_interval_is_of_the_difference_and_of_no_mean(
    split: SplitArrays, protocol: ProtocolDocument, headline: str
) -> None:
    """Three times as far at the quantile is a metre more, on average it is four."""
    a, b = scores(3), scores(4)
    a.values[:, 1:4] = 3 * b.values[:, 1:4]
    by = protocol.model_copy(
        update={"grading": protocol.grading.model_copy(update={"headline": headline})}
    )
    told = compare(a, b, split, by, TOY).overall
    pairs = [(told["quantile"], told["mean"])]
    of_families = [compare(a, b, split, by, toy(METRICS[at : at + 1])).families for at in (2, 3)]
    pairs += zip(*(families.values() for families in of_families), strict=True)
    for quantile, mean in pairs:
        assert quantile.interval is not None
        assert mean.interval is not None
        assert quantile.interval[0] <= (quantile.difference or 0.0) <= quantile.interval[1]
        assert quantile.interval[1] < mean.interval[0]


def test_a_first_metric_that_is_a_minimum_is_compared_by_task(
    split: SplitArrays, protocol: ProtocolDocument
) -> None:
    a, b = (SampleScores(METRICS[1:], scores(seed).values[:, 1:]) for seed in (5, 6))
    found = compare(a, b, split, protocol, toy(METRICS[1:]))
    assert found.tasks.keys() == {task.id for task in protocol.tasks}
    gaps = a.values[:, 0] - b.values[:, 0]
    for index, task in enumerate(protocol.tasks):
        both = (split.task_index == index) & ~np.isnan(gaps)
        least_a, least_b = (np.min(each.values[both, 0]) for each in (a, b))
        difference = found.tasks[task.id].difference
        assert difference == pytest.approx(least_a - least_b)
    assert scene_sums(a, split, protocol.taxonomy, by_task=True).values.shape == (N, 2)


def test_of_means_alone_there_are_sums_alone(
    split: SplitArrays, protocol: ProtocolDocument
) -> None:
    alone = SampleScores((HCC,), scores(1).values[:, :1])
    assert scene_sums(alone, split, protocol.taxonomy).values.size == 0


def test_a_quantile_alone_has_a_level() -> None:
    for aggregation, level in (("quantile", None), ("minimum", 0.5), ("mean", 0.5)):
        with pytest.raises(ValidationError, match="a quantile, and nothing else"):
            metric(aggregation, level)
