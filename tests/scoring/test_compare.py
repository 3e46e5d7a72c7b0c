"""Two entries on the same samples: difference, interval, discordant share, plain verdict."""

from collections.abc import Callable
from itertools import combinations

import numpy as np
import pytest
from tests.scoring.made import SIX_METRICS, answers_alone

from exceptiondrive_schemas.challenges import STRATEGY
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.score_sheet import PairedDifference
from exceptiondrive_scoring.aliases import FloatArray, IntArray
from exceptiondrive_scoring.arrays import SplitArrays
from exceptiondrive_scoring.bootstrap import bootstrap, scene_sums
from exceptiondrive_scoring.compare import compare
from exceptiondrive_scoring.grade import SampleScores
from exceptiondrive_scoring.rank import rank_intervals
from exceptiondrive_scoring.strategy import grade_strategies

MakeSplit = Callable[..., SplitArrays]
N, SCENES = 400, 100


@pytest.fixture
def split(make_split: MakeSplit) -> SplitArrays:
    rng = np.random.default_rng(5)
    return make_split(
        np.zeros((N, 4, 2)),
        tasks=rng.integers(0, 21, N).tolist(),
        scenes=(np.arange(N) % SCENES).tolist(),
    )


def _scores(unsafe: "np.ndarray[tuple[int, ...], np.dtype[np.bool_]]") -> SampleScores:
    hcc = 0.5 * ~unsafe
    return SampleScores(
        SIX_METRICS.metrics, np.column_stack([hcc, unsafe, hcc, *([np.ones(N)] * 3)])
    )


def test_an_entry_compared_with_itself_is_not_separable(
    split: SplitArrays, protocol: ProtocolDocument
) -> None:
    scores = _scores(np.random.default_rng(1).random(N) < 0.8)
    comparison = compare(scores, scores, split, protocol, SIX_METRICS)
    for difference in comparison.overall.values():
        assert difference.difference == 0
        assert difference.interval == (0, 0)
        assert difference.discordant == 0
        assert difference.verdict == "not separable on this split"


def test_values_that_differ_in_their_last_bits_alone_are_the_same(
    split: SplitArrays, protocol: ProtocolDocument
) -> None:
    a, b = (_scores(np.zeros(N, np.bool_)) for _ in "ab")
    a.values[:, 0] = np.nextafter(b.values[:, 0], 1.0)
    a.values[::4, 0] = b.values[::4, 0] + 1e-6
    hcc = compare(a, b, split, protocol, SIX_METRICS).overall["hcc"]
    assert hcc.discordant == np.mean(np.arange(N) % 4 == 0)


def test_paired_samples_separate_what_single_intervals_do_not(
    split: SplitArrays, protocol: ProtocolDocument
) -> None:
    rng = np.random.default_rng(1)
    b_unsafe = rng.random(N) < 0.8
    a_unsafe = b_unsafe & (rng.random(N) >= 0.05)  # A is safe wherever B is, and a little more
    a, b = _scores(a_unsafe), _scores(b_unsafe)
    comparison = compare(a, b, split, protocol, SIX_METRICS)
    ur = comparison.overall["ur"]
    assert ur.discordant == np.mean(a_unsafe != b_unsafe)
    assert ur.interval is not None
    assert ur.interval[0] < (ur.difference or 0) < ur.interval[1] < 0
    assert ur.verdict == "A is better"
    assert comparison.overall["hcc"].verdict == "A is better"
    assert compare(b, a, split, protocol, SIX_METRICS).overall["ur"].verdict == "B is better"
    sums = [scene_sums(scores, split, protocol.taxonomy) for scores in (a, b)]
    first, second = bootstrap(sums, SIX_METRICS, protocol.ranking, protocol.grading.headline)
    assert first.macro_family[1, 1] > second.macro_family[1, 0]  # single intervals overlap
    assert rank_intervals([first, second], "descending", 0.95).tolist() == [[1, 1], [2, 2]]


@pytest.mark.parametrize(("n_differing", "is_told"), [(4, False), (8, True)])
def test_few_scenes_that_differ_do_not_say_which_is_better(
    split: SplitArrays, protocol: ProtocolDocument, n_differing: int, *, is_told: bool
) -> None:
    hits = np.random.default_rng(2).random(N) < 0.5
    a, b = _scores(hits), _scores(hits | (np.arange(N) % SCENES < n_differing))
    a.values[:n_differing, 0], b.values[:n_differing, 0] = 1.0, 0.0
    found = compare(a, b, split, protocol, SIX_METRICS).overall["hcc"]
    assert (found.verdict == "A is better") is is_told
    entries = [scene_sums(each, split, protocol.taxonomy) for each in (a, b)]
    uncertain = list(bootstrap(entries, SIX_METRICS, protocol.ranking, "macro_family"))
    ranges = rank_intervals(uncertain, "descending", 0.95).tolist()
    assert ranges == ([[1, 1], [2, 2]] if is_told else [[1, 2], [1, 2]])


def _verdict_and_ranges(
    hcc: FloatArray, scenes: IntArray, make_split: MakeSplit, protocol: ProtocolDocument
) -> tuple[str, list[list[int]]]:
    """What comparison and rank ranges say of two entries, (2, N), by HCC; families follow one another."""
    n = hcc.shape[1]
    tasks = [4 * (at % 6) for at in range(n)]
    split = make_split(np.zeros((n, 4, 2)), tasks=tasks, scenes=scenes.tolist())
    a, b = (SampleScores(SIX_METRICS.metrics, np.tile(row[:, None], 6)) for row in hcc)
    sums = [scene_sums(each, split, protocol.taxonomy) for each in (a, b)]
    headline = protocol.grading.headline
    uncertain = list(bootstrap(sums, SIX_METRICS, protocol.ranking, headline))
    verdict = compare(a, b, split, protocol, SIX_METRICS).overall["hcc"].verdict
    return verdict, rank_intervals(uncertain, "descending", 0.95).tolist()


@pytest.mark.parametrize(("n_scenes", "n_differing"), [(5, 5), (6, 4), (6, 5), (8, 5), (6, 6)])
def test_fewer_than_six_scenes_that_differ_never_say_which_is_better(
    n_scenes: int, n_differing: int, make_split: MakeSplit, protocol: ProtocolDocument
) -> None:
    """Whichever they are, and whether or not some draw takes none of them: a sign test at 95 % takes six."""
    scenes = np.repeat(np.arange(n_scenes), 6)
    told = ("A is better", [[1, 1], [2, 2]])
    open_ = ("not separable on this split", [[1, 2], [1, 2]])
    for differing in combinations(range(n_scenes), n_differing):
        differs = np.isin(scenes, differing)
        hcc = np.where(differs, [[1.0], [0.0]], 0.5)
        found = _verdict_and_ranges(hcc, scenes, make_split, protocol)
        assert found == (told if n_differing == 6 else open_), differing


def test_scenes_in_which_two_exchange_samples_do_not_tell_them_apart(
    make_split: MakeSplit, protocol: ProtocolDocument
) -> None:
    """A scene differs where its sum does, to comparison and rank range alike."""
    scenes = np.repeat(np.arange(30), 12)
    half, hcc = np.arange(12 * 30) % 12 < 6, np.full((2, 12 * 30), 0.5)
    hcc[:, scenes < 15] = [[1.0], [0.0]] * half[scenes < 15]
    hcc[1, (scenes >= 5) & (scenes < 15)] = ~half[(scenes >= 5) & (scenes < 15)]
    found = _verdict_and_ranges(hcc, scenes, make_split, protocol)
    assert found == ("not separable on this split", [[1, 2], [1, 2]])


def test_a_diagnostic_is_higher_and_never_better(
    split: SplitArrays, protocol: ProtocolDocument
) -> None:
    unsafe = np.random.default_rng(1).random(N) < 0.8
    a, b = _scores(unsafe), _scores(unsafe)
    a.values[:, 3] += 1.0
    difference = compare(a, b, split, protocol, SIX_METRICS).overall["cts"]
    assert difference.difference == pytest.approx(1.0)
    assert difference.verdict == "A is higher"


def test_families_are_compared_where_they_have_samples(
    make_split: MakeSplit, protocol: ProtocolDocument
) -> None:
    split = make_split(np.zeros((N, 4, 2)), tasks=[0, 4] * (N // 2))
    unsafe = np.arange(N) % 4 < 2
    comparison = compare(_scores(unsafe), _scores(~unsafe), split, protocol, SIX_METRICS)
    assert list(comparison.families) == ["sudden_emergence", "lane_blockage"]
    hcc = comparison.families["lane_blockage"]
    assert (hcc.difference, hcc.discordant) == (0.0, 1.0)
    assert hcc.verdict == "not separable on this split"


def test_tasks_are_compared_by_the_first_metric_on_the_draws_of_everything_else(
    make_split: MakeSplit, protocol: ProtocolDocument
) -> None:
    """One task in a family: the task is the family, to the last bit."""
    scenes = (np.arange(N) % SCENES).tolist()
    split = make_split(np.zeros((N, 4, 2)), tasks=[0, 4] * (N // 2), scenes=scenes)
    rng = np.random.default_rng(3)
    a, b = _scores(rng.random(N) < 0.4), _scores(rng.random(N) < 0.6)
    comparison = compare(a, b, split, protocol, SIX_METRICS)
    tasks = [protocol.tasks[index] for index in (0, 4)]
    assert list(comparison.tasks) == [task.id for task in tasks]
    for task in tasks:
        assert comparison.tasks[task.id] == comparison.families[task.family]


def test_samples_that_either_leaves_undefined_are_left_out(
    split: SplitArrays, protocol: ProtocolDocument
) -> None:
    unsafe = np.random.default_rng(1).random(N) < 0.8
    a, b = _scores(unsafe), _scores(unsafe)
    a.values[: N // 2, 3] = np.nan
    b.values[N // 2 :, 3] = np.nan
    difference = compare(a, b, split, protocol, SIX_METRICS).overall["cts"]
    assert (difference.difference, difference.interval, difference.discordant) == (None, None, None)
    assert difference.verdict == "no interval"


def test_no_file_asks_another_for_its_value_in_a_few_samples(
    split: SplitArrays, protocol: ProtocolDocument
) -> None:
    """One that defines a metric in one sample, of the split or of a family, would read it to the last digit."""
    unsafe = np.random.default_rng(1).random(N) < 0.8
    a, b = _scores(unsafe), _scores(unsafe)
    a.values[:, 3] = np.random.default_rng(2).random(N)
    own = np.flatnonzero(split.family_index == split.family_index[0])

    def found(undefined: "np.ndarray[tuple[int, ...], np.dtype[np.intp]]") -> object:
        asks = _scores(unsafe)
        asks.values[undefined, 3] = np.nan
        told = compare(a, asks, split, protocol, SIX_METRICS).overall
        assert told["hcc"] == compare(a, b, split, protocol, SIX_METRICS).overall["hcc"]
        return told["cts"]

    half = len(own) // 2
    for few in (np.arange(1, N), own[1:], own[: half + 1]):
        assert found(few) == PairedDifference(
            difference=None, interval=None, discordant=None, verdict="no interval"
        )
    told = found(own[:half])
    assert isinstance(told, PairedDifference)
    assert told.difference is not None
    assert told.interval is not None


def test_the_reminder_effect_is_the_paired_difference_of_two_submissions(
    split: SplitArrays, protocol: ProtocolDocument
) -> None:
    rng = np.random.default_rng(2)
    without = rng.integers(0, 5, N)
    acceptable = split.acceptable.argmax(axis=1)
    with_reminder = np.where(rng.random(N) < 0.3, acceptable, without)
    graded = [
        grade_strategies(answers_alone(answers), split, protocol)
        for answers in (with_reminder, without)
    ]
    effect = compare(graded[0], graded[1], split, protocol, STRATEGY)
    accuracy = effect.overall["accuracy"]
    assert accuracy.interval is not None
    assert accuracy.interval[0] > 0
    assert accuracy.verdict == "A is better"
    assert effect.overall["under_warning"].verdict == "A is better"
    assert effect.overall["missing"].discordant == 0
