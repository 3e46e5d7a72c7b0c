"""The bootstrap against loops that share no code with it, and its coverage in simulation."""

from collections.abc import Callable
from typing import Literal

import numpy as np
import pytest
from tests.scoring.made import SIX_METRICS

from exceptiondrive_schemas.protocol import ProtocolDocument, RankingSection, packaged_protocol
from exceptiondrive_scoring.aliases import FloatArray
from exceptiondrive_scoring.arrays import SplitArrays
from exceptiondrive_scoring.bootstrap import (
    GRID,
    SceneSums,
    Uncertainty,
    bootstrap,
    fewest_scenes,
    scene_counts,
    scene_sums,
    scenes_by_freedom,
)
from exceptiondrive_scoring.compare import compare
from exceptiondrive_scoring.grade import SampleScores
from exceptiondrive_scoring.rank import long_rank_intervals, rank_intervals

MakeSplit = Callable[..., SplitArrays]
NAN = float("nan")
N, SCENES = 240, 60


@pytest.fixture
def split(make_split: MakeSplit) -> SplitArrays:
    rng = np.random.default_rng(5)
    return make_split(
        np.zeros((N, 4, 2)),
        tasks=rng.integers(0, 21, N).tolist(),
        scenes=rng.permutation(np.arange(N) % SCENES).tolist(),
    )


def _scores(seed: int, *, safe: float = 0.3, missing_source: float = 0.0) -> SampleScores:
    rng = np.random.default_rng(seed)
    is_safe = rng.random(N) < safe
    hcc, hpr = is_safe * rng.random(N), is_safe * rng.random(N)
    cts = rng.gamma(2.0, 1.0, (N, 3))
    cts[rng.random(N) < missing_source] = NAN
    return SampleScores(SIX_METRICS.metrics, np.column_stack([hcc, ~is_safe, hpr, cts]))


def _one(scores: SampleScores, split: SplitArrays, protocol: ProtocolDocument) -> Uncertainty:
    sums = scene_sums(scores, split, protocol.taxonomy)
    (result,) = bootstrap([sums], SIX_METRICS, protocol.ranking, protocol.grading.headline)
    return result


def _naive_draws(
    scores: SampleScores, split: SplitArrays, ranking: RankingSection
) -> dict[str, FloatArray]:
    """Gather the samples of the drawn scenes, draw by draw, and average them."""
    rng = np.random.Generator(np.random.PCG64(ranking.bootstrap_seed))
    samples = [np.flatnonzero(split.scene_index == s) for s in range(split.n_scenes)]
    micro, macro, families = [], [], []
    for _ in range(ranking.bootstrap_draws):
        taken = rng.integers(0, split.n_scenes, size=split.n_scenes)
        rows = np.concatenate([samples[scene] for scene in taken])
        values, family = scores.values[rows], split.family_index[rows]
        means = np.stack([_mean(values[family == f]) for f in range(6)])
        families.append(means)
        micro.append(_mean(values))
        macro.append(_mean(means))
    return {"micro": np.array(micro), "macro": np.array(macro), "families": np.array(families)}


def _mean(values: FloatArray) -> FloatArray:
    defined = ~np.isnan(values)
    sums = np.where(defined, values, 0).sum(axis=0)
    return np.where(defined.any(axis=0), sums / np.maximum(defined.sum(axis=0), 1), NAN)


@pytest.mark.parametrize("missing_source", [0.0, 0.3])
def test_intervals_agree_with_gathering_samples_draw_by_draw(
    missing_source: float, split: SplitArrays, protocol: ProtocolDocument
) -> None:
    scores = _scores(1, missing_source=missing_source)
    result = _one(scores, split, protocol)
    naive = _naive_draws(scores, split, protocol.ranking)
    np.testing.assert_allclose(result.primary_draws, naive["macro"][:, 0], atol=1e-9)
    for interval, draws in ((result.micro, naive["micro"]), (result.families, naive["families"])):
        inside = (draws >= interval[..., 0] - 1e-9) & (draws <= interval[..., 1] + 1e-9)
        share = inside.mean(axis=0)
        assert ((share >= 0.95 - 1e-9) & (share < 0.985)).all()
        ends = np.sort(draws, axis=0)
        nearest = np.abs(ends[None] - np.moveaxis(interval, -1, 0)[:, None]).min(axis=1)
        np.testing.assert_allclose(nearest, 0, atol=1e-9)


def test_a_draw_that_holds_no_sample_of_a_family_averages_the_others(
    make_split: MakeSplit, protocol: ProtocolDocument
) -> None:
    tasks = [*range(21)] + [0] * (N - 21)
    split = make_split(np.zeros((N, 4, 2)), tasks=tasks, scenes=[i % SCENES for i in range(N)])
    scores = _scores(1)
    naive = _naive_draws(scores, split, protocol.ranking)
    assert np.isnan(naive["families"][..., 0]).any(axis=0).sum() > 1
    found = _one(scores, split, protocol).primary_draws
    np.testing.assert_allclose(found, naive["macro"][:, 0], atol=1e-9)


@pytest.mark.parametrize(
    ("of_families", "worth", "freedom", "fewest"),
    [
        pytest.param(
            [range(2), range(2, 9)],
            4 / (1 / 2 + 1 / 7),
            (1 / 2 + 1 / 7) ** 2 / (1 / (4 * 1) + 1 / (49 * 6)),
            2,
            id="of families that have any",
        ),
        pytest.param([range(6), range(6)], 6.0, 5.0, 6, id="never more than there are scenes"),
    ],
)
def test_how_many_scenes_the_mean_of_families_is_worth_and_its_degrees_of_freedom(
    of_families: list[range], worth: float, freedom: float, fewest: int
) -> None:
    counts = np.zeros((6, 1, 9))
    for family, scenes in enumerate(of_families):
        counts[family, 0, list(scenes)] = 2
    n = scene_counts(SceneSums(counts, counts))
    assert n.macro_family[0] == pytest.approx(worth)
    assert scenes_by_freedom(n).macro_family[0] == pytest.approx(1 + freedom)
    assert fewest_scenes(n).macro_family[0] == fewest


@pytest.mark.parametrize(("n_scenes", "has_interval"), [(1, False), (4, False), (5, True)])
def test_the_mean_of_families_has_no_interval_where_one_has_too_few_scenes(
    make_split: MakeSplit, n_scenes: int, *, has_interval: bool
) -> None:
    """Too few to say how the family varies: nothing else of the split says it."""
    protocol = packaged_protocol("1.1")
    tasks = [0] * (N - 10) + [4] * 10
    scenes = [i % SCENES for i in range(N - 10)] + [SCENES + i % n_scenes for i in range(10)]
    split = make_split(np.zeros((N, 4, 2)), tasks=tasks, scenes=scenes)
    found = _one(_scores(1), split, protocol)
    assert not np.isnan(found.micro).any()
    assert not np.isnan(found.families[0]).any()
    assert np.isnan(found.families[1]).all() != has_interval
    assert np.isnan(found.macro_family).all() != has_interval
    told = compare(_scores(1), _scores(2), split, protocol, SIX_METRICS)
    for difference in (told.overall["hcc"], told.families["lane_blockage"]):
        assert (difference.verdict == "no interval") != has_interval
    assert told.families["sudden_emergence"].interval is not None


def test_the_same_seed_gives_the_same_bits_whoever_else_is_on_the_board(
    split: SplitArrays, protocol: ProtocolDocument
) -> None:
    entries = [
        scene_sums(_scores(seed, missing_source=0.1 * (seed % 3)), split, protocol.taxonomy)
        for seed in range(20)
    ]
    together = bootstrap(entries, SIX_METRICS, protocol.ranking, "micro")
    for entry, among_others in zip(entries, together, strict=True):
        (alone,) = bootstrap([entry], SIX_METRICS, protocol.ranking, "micro")
        for name in ("micro", "macro_family", "families", "primary_draws"):
            np.testing.assert_array_equal(getattr(alone, name), getattr(among_others, name))


def test_an_entry_keeps_alive_no_more_than_its_own_arrays(
    split: SplitArrays, protocol: ProtocolDocument
) -> None:
    """10,000 entries are held at once: a view of one metric would hold all of them."""
    own = vars(_one(_scores(1), split, protocol)).values()
    assert all(each.base is None for each in own if isinstance(each, np.ndarray))


def test_another_seed_gives_other_draws(split: SplitArrays, protocol: ProtocolDocument) -> None:
    ranking = protocol.ranking.model_copy(update={"bootstrap_seed": 1})
    other = protocol.model_copy(update={"ranking": ranking})
    scores = _scores(1)
    first, second = (_one(scores, split, p).primary_draws for p in (protocol, other))
    assert (first != second).any()


def test_a_fraction_of_zero_or_one_has_wilsons_interval(
    split: SplitArrays, protocol: ProtocolDocument
) -> None:
    result = _one(_scores(1, safe=0.0), split, protocol)
    hcc, ur = result.micro[:2]
    assert hcc.tolist() == pytest.approx([0.0, 3.8415 / (SCENES + 3.8415)], abs=1e-4)
    assert ur.tolist() == pytest.approx([SCENES / (SCENES + 3.8415), 1.0], abs=1e-4)
    assert result.macro_family[0, 1] >= hcc[1]
    assert (result.families[:, 0, 1] > hcc[1]).all()


def test_a_shift_of_zero_everywhere_is_known_exactly(
    split: SplitArrays, protocol: ProtocolDocument
) -> None:
    scores = _scores(1)
    scores.values[:, 3:] = 0.0
    assert _one(scores, split, protocol).micro[3].tolist() == [0.0, 0.0]


def test_one_scene_says_nothing_about_another(
    make_split: MakeSplit, protocol: ProtocolDocument
) -> None:
    split = make_split(np.zeros((N, 4, 2)), scenes=[0] * N)
    result = _one(_scores(1), split, protocol)
    for intervals in (result.micro, result.macro_family, result.families):
        assert np.isnan(intervals).all()


def test_an_undefined_metric_has_no_interval(
    split: SplitArrays, protocol: ProtocolDocument
) -> None:
    result = _one(_scores(1, missing_source=1.1), split, protocol)
    assert np.isnan(result.micro[3:]).all()
    assert not np.isnan(result.micro[:3]).any()


def test_scene_sums_lie_on_a_grid_finer_than_a_billionth(
    split: SplitArrays, protocol: ProtocolDocument
) -> None:
    scores = _scores(1)
    sums = scene_sums(scores, split, protocol.taxonomy)
    assert GRID < 1e-9
    np.testing.assert_array_equal(sums.sums / GRID, np.rint(sums.sums / GRID))
    np.testing.assert_allclose(sums.sums.sum(axis=(0, 2)), scores.values.sum(axis=0), atol=1e-6)
    np.testing.assert_array_equal(sums.counts.sum(axis=(0, 2)), np.full(6, N))


def _entries(
    draws: list[list[float]], cut: int, n_differing: int = 400, first: int = 0
) -> list[Uncertainty]:
    """Entries, each of which differs from the others in so many scenes of 400."""
    nothing = np.empty((0, 2))
    scenes = np.zeros((len(draws), 400))
    scenes[:, :n_differing] = np.arange(first, first + len(draws))[:, None]
    return [
        Uncertainty(nothing, nothing, nothing, np.array(row), cut, each)
        for row, each in zip(draws, scenes, strict=True)
    ]


def test_a_rank_interval_counts_who_is_surely_better_and_surely_worse() -> None:
    a, b = [5.0, 5.0, 5.0, 5.0], [4.0, 4.0, 4.0, 6.0]
    c, d = [1.0, 1.0, 1.0, 1.0], [1.0, 1.0, 1.0, 1.0]
    sure_of_all = rank_intervals(_entries([a, b, c, d], cut=0), "descending", 0.3)
    assert sure_of_all.tolist() == [[1, 2], [1, 2], [3, 4], [3, 4]]
    one_cut_off = rank_intervals(_entries([a, b, c, d], cut=1), "descending", 0.3)
    assert one_cut_off.tolist() == [[1, 1], [2, 2], [3, 4], [3, 4]]
    less_is_better = rank_intervals(_entries([a, b, c, d], cut=1), "ascending", 0.3)
    assert less_is_better.tolist() == [[4, 4], [3, 3], [1, 2], [1, 2]]


def test_rank_intervals_of_an_empty_board() -> None:
    assert rank_intervals([], "descending", 0.95).shape == (0, 2)


@pytest.mark.parametrize("share", [0.04, 0.12, 1.0])
def test_rank_intervals_say_what_comparing_each_with_each_says(
    split: SplitArrays, protocol: ProtocolDocument, share: float
) -> None:
    """Also where entries differ in few scenes, of which many draws take none."""
    base = _scores(0, safe=0.5)
    rng, scores = np.random.default_rng(5), []
    for seed in range(12):
        other = _scores(seed + 1, safe=0.2 + 0.05 * seed)
        takes = (rng.random(SCENES) < share)[split.scene_index][:, None]
        scores.append(SampleScores(base.metrics, np.where(takes, other.values, base.values)))
    sums = [scene_sums(each, split, protocol.taxonomy) for each in scores]
    ranking, headline = protocol.ranking, protocol.grading.headline
    uncertain = list(bootstrap(sums, SIX_METRICS, ranking, headline))
    found = rank_intervals(uncertain, "descending", ranking.confidence)
    n_sure = 0
    for i, mine in enumerate(scores):
        best, worst = 1, len(scores)
        for other in scores[:i] + scores[i + 1 :]:
            verdict = compare(mine, other, split, protocol, SIX_METRICS).overall["hcc"].verdict
            best += verdict == "B is better"
            worst -= verdict == "A is better"
        assert found[i].tolist() == [best, worst], i
        n_sure += best - 1
    assert (n_sure > 0) is (share > 0.04)


@pytest.mark.parametrize("order", ["descending", "ascending"])
@pytest.mark.parametrize("what", ["values", "ties", "undefined draws"])
def test_rank_intervals_of_many_are_those_of_every_pair(
    order: Literal["descending", "ascending"], what: str
) -> None:
    rng = np.random.default_rng(len(what))
    level, shared = rng.uniform(0.0, 1.0, (90, 1)), rng.normal(0.0, 0.03, 60)
    draws = level + shared * rng.uniform(0.5, 1.5, (90, 1)) + rng.normal(0.0, 0.02, (90, 60))
    if what == "ties":
        draws = np.round(draws, 2)
    elif what == "undefined draws":
        draws[rng.random(draws.shape) < 0.002] = NAN
    cuts = rng.integers(1, 4, 90)
    entries = [
        _entries([row.tolist()], int(cut), first=number)[0]
        for number, (row, cut) in enumerate(zip(draws, cuts, strict=True))
    ]
    found = rank_intervals(entries, order, 0.85)
    signed = draws if order == "descending" else -draws
    sure = [
        [
            np.count_nonzero(a > b) >= 60 - min(cut_a, cut_b)
            for b, cut_b in zip(signed, cuts, strict=True)
        ]
        for a, cut_a in zip(signed, cuts, strict=True)
    ]
    better, worse = np.count_nonzero(sure, axis=0), np.count_nonzero(sure, axis=1)
    np.testing.assert_array_equal(found, np.column_stack([1 + better, 90 - worse]))
    assert better.max() > 40


def test_beyond_the_first_entries_of_a_long_board_intervals_say_who_is_surely_better() -> None:
    rng = np.random.default_rng(7)
    draws = np.sort(rng.uniform(0.0, 1.0, 40))[::-1, None] + rng.normal(0.0, 0.05, (40, 60))
    entries = _entries(draws.tolist(), cut=2)
    intervals = np.sort(draws, axis=1)[:, [2, -3]]
    found = long_rank_intervals(entries, intervals, "descending", 0.85, n_paired=15)
    paired = rank_intervals(entries[:15], "descending", 0.85)
    low, high = intervals.T
    for i in range(40):
        others = slice(15, None) if i < 15 else slice(None)
        better = np.count_nonzero(low[others] > high[i])
        worse = np.count_nonzero(high[others] < low[i])
        best, worst = paired[i] if i < 15 else (1, 15)
        assert found[i].tolist() == [best + better, worst + 25 - worse], i
    every = long_rank_intervals(entries, intervals, "descending", 0.85, n_paired=40)
    np.testing.assert_array_equal(every, rank_intervals(entries, "descending", 0.85))
    assert (found[:, 0] <= every[:, 0]).all()
    assert (found[:, 1] >= every[:, 1]).all()
    mirrored = long_rank_intervals(
        _entries((-draws).tolist(), cut=2), -intervals[:, ::-1], "ascending", 0.85, n_paired=15
    )
    np.testing.assert_array_equal(mirrored, found)


def _simulated_boards(
    n_boards: int, n_scenes: int
) -> tuple[list[SceneSums], FloatArray, FloatArray]:
    """Boards of one true planner: samples of a scene are alike. Also the true means."""
    rng = np.random.default_rng(20261121)
    share = np.array([0.2556, 0.1975, 0.2496, 0.0360, 0.0910, 0.1703])
    unsafe = np.array([0.75, 0.80, 0.70, 0.90, 0.85, 0.80])
    hcc_if_safe = np.array([0.6, 0.5, 0.7, 0.4, 0.5, 0.6])
    threshold = np.array([0.6745, 0.8416, 0.5244, 1.2816, 1.0364, 0.8416])  # normal quantiles
    boards = []
    for _ in range(n_boards):
        scene = np.repeat(np.arange(n_scenes), np.maximum(rng.poisson(4.0, n_scenes), 1))
        family = rng.choice(6, len(scene), p=share / share.sum())
        alike = np.sqrt(0.4) * rng.normal(size=n_scenes)[scene]
        is_unsafe = alike + np.sqrt(0.6) * rng.normal(size=len(scene)) < threshold[family]
        hcc = ~is_unsafe * rng.beta(2 * hcc_if_safe[family], 2 - 2 * hcc_if_safe[family])
        values = np.column_stack([hcc, is_unsafe])
        sums, counts = np.zeros((2, 6, n_scenes, 2))
        np.add.at(sums, (family, scene), values)
        np.add.at(counts, (family, scene), 1)
        sums, counts = sums.swapaxes(1, 2), counts.swapaxes(1, 2)
        pick = [0, 1, 0, 0, 0, 0]
        boards.append(SceneSums(np.rint(sums[:, pick] / GRID) * GRID, counts[:, pick]))
    means = np.column_stack([(1 - unsafe) * hcc_if_safe, unsafe])
    return boards, share / share.sum() @ means, means


def test_95_per_cent_intervals_cover_the_truth_in_93_to_97_per_cent_of_boards(
    protocol: ProtocolDocument,
) -> None:
    boards, true_micro, true_families = _simulated_boards(n_boards=600, n_scenes=500)
    results = list(bootstrap(boards, SIX_METRICS, protocol.ranking, "macro_family"))

    def coverage(intervals: FloatArray, truth: FloatArray) -> FloatArray:
        inside = (intervals[..., 0] <= truth) & (truth <= intervals[..., 1])
        share: FloatArray = inside.mean(axis=0)
        return share

    micro = coverage(np.stack([r.micro[:2] for r in results]), true_micro)
    macro = coverage(np.stack([r.macro_family[:2] for r in results]), true_families.mean(axis=0))
    families = coverage(np.stack([r.families[:, :2] for r in results]), true_families)
    overall = np.concatenate([micro, macro, families.mean(axis=0)])
    assert ((overall >= 0.93) & (overall <= 0.97)).all(), overall
    assert (families >= 0.91).all(), families
