"""How alike submissions are: laws, tolerance, and fingerprints that nobody can aim at."""

import gzip
import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from tests.support import realdata

from exceptiondrive_schemas.challenges import CHALLENGES, ChallengeId
from exceptiondrive_scoring.planning import PlanningScoring
from exceptiondrive_scoring.similarity import (
    FARTHEST,
    FINGERPRINT_SAMPLES,
    FIRST_LOOK,
    SLACK,
    Alikeness,
    alikeness,
    compare_pair,
    distances,
    fingerprinted_samples,
    may_be_alike,
)
from exceptiondrive_scoring.strategy import StrategyScoring

PLANNING = PlanningScoring.alike
STRATEGY = StrategyScoring.alike


def ways(seed: int, n_samples: int = 3181) -> np.ndarray:
    steps = np.random.default_rng(seed).normal([2.0, 0.0], 0.8, (n_samples, 6, 2))
    return np.cumsum(steps, axis=1)


def test_a_copy_is_equal_and_a_stranger_is_not() -> None:
    copy, n_different = compare_pair(ways(1), ways(1), PLANNING)
    assert (copy.equal_share, copy.mean_distance, n_different) == (1.0, 0.0, 0)
    stranger, n_different = compare_pair(ways(1), ways(2), PLANNING)
    assert not PLANNING.is_alike(stranger, SLACK)
    assert n_different == 3181


@pytest.mark.parametrize(
    ("change", "is_alike"),
    [
        (lambda w: w + np.random.default_rng(3).normal(0, 0.1, w.shape), True),
        (lambda w: np.round(w, 1), True),
        (lambda w: np.concatenate([ways(9)[:300], w[300:]]), True),
        (lambda w: w + np.random.default_rng(3).normal(0, 1.0, w.shape), False),
        (lambda w: np.concatenate([ways(9)[:2000], w[2000:]]), False),
    ],
    ids=["noise-of-10-cm", "rounded", "a-tenth-replaced", "noise-of-1-m", "most-replaced"],
)
def test_a_copy_with_small_changes_is_still_alike(change: object, is_alike: bool) -> None:
    changed = change(ways(1))  # type: ignore[operator]
    found, _ = compare_pair(ways(1), changed, PLANNING)
    assert PLANNING.is_alike(found) == is_alike
    chosen = fingerprinted_samples(3181, "seed")
    (by_fingerprint,) = alikeness(ways(1)[chosen], changed[chosen][None], PLANNING)
    assert PLANNING.is_alike(by_fingerprint, SLACK) == is_alike


@pytest.mark.parametrize(
    ("equal_share", "mean_m", "aligned_share", "is_alike", "is_probe"),
    [
        (0.9, 2.0, 0.0, True, True),
        (0.89, 2.0, 0.0, False, False),
        (0.0, 0.25, 0.0, True, False),
        (0.0, 0.26, 0.0, False, False),
        (0.0, 2.0, 0.9, True, True),
        (0.0, 2.0, 1.0, True, False),
    ],
)
def test_a_rule_holds_from_its_own_values_on(
    equal_share: float, mean_m: float, aligned_share: float, *, is_alike: bool, is_probe: bool
) -> None:
    found = Alikeness(equal_share, mean_m, aligned_share)
    assert (PLANNING.is_alike(found), PLANNING.is_probe(found)) == (is_alike, is_probe)


def test_one_sample_far_away_never_decides() -> None:
    changed = ways(1)
    changed[7] += 150.0
    found, n_different = compare_pair(ways(1), changed, PLANNING)
    assert n_different == 1
    assert found.mean_distance == pytest.approx(FARTHEST / 3181)
    assert PLANNING.is_probe(found)


def test_missing_in_both_is_alike_and_in_one_is_not() -> None:
    a, b = ways(1, 4), ways(1, 4)
    a[0] = b[0] = np.nan
    b[1] = np.nan
    assert distances(a, b).tolist() == [0.0, FARTHEST, 0.0, 0.0]


def test_answers_of_the_strategy_challenge_are_letters() -> None:
    letters = np.array([0, 1, 2, 3, -1], dtype=np.int8)
    other = np.array([0, 1, 4, 3, -1], dtype=np.int8)
    found, n_different = compare_pair(
        STRATEGY.ways({"strategy": letters}), STRATEGY.ways({"strategy": other}), STRATEGY
    )
    assert (found.equal_share, n_different) == (0.8, 1)


@given(st.integers(0, 5), st.integers(6, 11))
def test_distance_is_symmetric_and_bounded(a: int, b: int) -> None:
    apart = distances(ways(a, 20), ways(b, 20))
    assert (apart == distances(ways(b, 20), ways(a, 20))).all()
    assert ((apart >= 0) & (apart <= FARTHEST)).all()


@given(
    st.integers(0, 1000),
    st.sampled_from([5, 63, 64, 65, 256]),
    st.sampled_from([0.0, 0.01, 0.04, 0.06]),
    st.floats(0.0, 0.4),
    st.sampled_from([0.0, 0.05, 0.5]),
    st.sampled_from([np.float32, np.float64]),
)
def test_a_first_look_passes_over_no_copy(
    seed: int, n_samples: int, noise_m: float, changed: float, missing: float, kind: type
) -> None:
    rng = np.random.default_rng(seed)
    one = ways(seed, n_samples)
    one[rng.random(n_samples) < missing / 2] = np.nan
    others = np.repeat(one[None], 6, axis=0) * rng.uniform(0.75, 1.3, (6, 1, 1, 1))
    others += rng.normal(0, 0.5, (6, 1, 1, 2)) + rng.normal(0, noise_m, others.shape)
    others[rng.random((6, n_samples)) < changed] += [3.0, 1.0]
    others[rng.random((6, n_samples)) < missing / 2] = np.nan
    one, others = one.astype(kind), others.astype(kind)
    may = may_be_alike(one, others, PLANNING, SLACK)
    for found, is_open in zip(alikeness(one, others, PLANNING), may, strict=True):
        is_candidate = PLANNING.is_alike(found, SLACK) or PLANNING.is_probe(found, SLACK)
        assert is_open or not is_candidate


def test_a_first_look_is_enough_where_it_sees_no_copy() -> None:
    one = ways(0, 256)
    is_new = np.arange(256)[:, None, None] < FIRST_LOOK
    part = np.where(is_new, ways(1, 256), one) * 1.1
    (whole,) = alikeness(one, part[None], PLANNING)
    assert (whole.equal_share, whole.aligned_share) == (0.0, 0.75)
    assert may_be_alike(one, np.stack([part, one]), PLANNING, SLACK).tolist() == [False, True]
    assert alikeness(one, np.empty((0, *one.shape)), PLANNING) == []


def test_which_samples_are_fingerprinted_follows_from_the_seed_alone() -> None:
    one, two = fingerprinted_samples(3181, "one"), fingerprinted_samples(3181, "two")
    assert len(one) == FINGERPRINT_SAMPLES == len(set(one.tolist()))
    assert one.tolist() == fingerprinted_samples(3181, "one").tolist()
    assert len(np.intersect1d(one, two)) < FINGERPRINT_SAMPLES / 2
    assert fingerprinted_samples(5, "one").tolist() == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("split", realdata.PLANNERS)
def test_an_honest_season_of_real_planners_raises_no_alarm(split: str) -> None:
    """Ten revisions of each: trained anew, tuned in speed, another rule for a part of the scenes."""
    realdata.require()
    chance = np.random.default_rng(11)
    seasons = []
    for method in realdata.PLANNERS[split]:
        first = real_ways(split, method)
        for revision in range(10):
            ways = first + chance.normal(0, 0.02 * revision, first.shape)
            if revision % 3 == 1:
                ways *= chance.uniform(0.9, 1.1)
            if revision % 3 == 2:
                ways[chance.random(len(ways)) < chance.uniform(0.15, 0.4)] *= 0.8
            seasons.append(ways)
    chosen = fingerprinted_samples(len(seasons[0]), "seed")
    prints = np.stack([ways[chosen] for ways in seasons])
    n_alarms = {"own": 0, "others": 0}
    for later in range(1, len(prints)):
        for earlier, found in enumerate(alikeness(prints[later], prints[:later], PLANNING)):
            is_own = earlier // 10 == later // 10
            if is_own:
                n_alarms["own"] += PLANNING.is_probe(found)
            else:
                n_alarms["others"] += PLANNING.is_alike(found)
    assert n_alarms == {"own": 0, "others": 0}


def real_ways(split: str, method: str) -> NDArray[np.float64]:
    document = json.loads(gzip.decompress(realdata.file_path(split, method).read_bytes()))
    answers = sorted(document["predictions"], key=lambda each: each["sample_id"])
    missing = [[np.nan, np.nan]] * 6
    return np.array([each["edited"] or missing for each in answers], dtype=np.float64)


def test_the_words_of_a_challenge_tell_what_its_rule_compares() -> None:
    planning, strategy = CHALLENGES[ChallengeId("planning")], CHALLENGES[ChallengeId("strategy")]
    assert f"at most {100 * PlanningScoring.alike.tolerance:g} cm" in planning.words.alike
    one, other = (
        {"source": np.full((3, 6, 2), at), "edited": np.zeros((3, 6, 2))} for at in (1, 2)
    )
    ways = PlanningScoring.alike.ways
    assert np.array_equal(ways(one), ways(other)), "sources are not compared"
    assert StrategyScoring.alike.tolerance == 0
    assert "not compared" in planning.words.alike
    assert "strategy" in strategy.words.alike
