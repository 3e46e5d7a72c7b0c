"""Intervals, against printed tables and by counting."""

import numpy as np
import pytest

from exceptiondrive_scoring.interval import (
    draws_cut_off,
    percentile_intervals,
    student_quantile,
    wilson_at_the_ends,
    wilson_interval,
)


@pytest.mark.parametrize(
    ("freedom", "printed", "off_by"),
    [
        (5, 2.570582, 1.2e-3),
        (10, 2.228139, 1e-4),
        (30, 2.042272, 1.5e-6),
        (100, 1.983972, 1e-6),
        (1e9, 1.959964, 1e-6),
    ],
)
def test_students_quantile_agrees_with_the_printed_table(
    freedom: float, printed: float, off_by: float
) -> None:
    """The more degrees of freedom, the closer: each term of the expansion is seen."""
    assert student_quantile(1.959964, freedom) == pytest.approx(printed, rel=off_by)


def test_many_scenes_leave_two_and_a_half_per_cent_outside_at_each_end() -> None:
    assert draws_cut_off(1000, 0.95, 1e12) == 25
    assert draws_cut_off(10_000, 0.90, 1e12) == 500


def test_few_scenes_leave_fewer_draws_outside() -> None:
    cuts = [draws_cut_off(10_000, 0.95, n) for n in (1, 2, 5, 20, 100, 1000)]
    assert cuts == sorted(cuts)
    assert cuts[0] == 0
    assert cuts[3] == pytest.approx(160, abs=5)  # normal tail beyond 2.093 sqrt(20 / 19)


def test_the_interval_is_made_of_draws() -> None:
    draws = np.random.default_rng(3).permutation(np.arange(1000.0))
    many = np.array(1e9)
    assert percentile_intervals(draws, many, 0.95).tolist() == [25.0, 974.0]


def test_undefined_draws_are_left_out() -> None:
    draws = np.array([np.nan] * 500 + list(range(1000)))
    assert percentile_intervals(draws, np.array(1e9), 0.95).tolist() == [25.0, 974.0]
    assert np.isnan(percentile_intervals(np.full(10, np.nan), np.array(1e9), 0.95)).all()


@pytest.mark.parametrize(
    ("hits", "n", "low", "high"),
    [(0, 10, 0.0, 0.2775), (10, 10, 0.7225, 1.0), (15, 50, 0.1910, 0.4375)],
)
def test_wilson_agrees_with_values_worked_by_hand(
    hits: int, n: int, low: float, high: float
) -> None:
    interval = wilson_interval(np.array(hits / n), np.array(n), 0.95)
    np.testing.assert_allclose(interval, [low, high], atol=5e-4)


def test_wilson_replaces_only_intervals_that_shrank_to_zero_or_one() -> None:
    intervals = np.array([[0.0, 0.0], [1.0, 1.0], [0.0, 0.2], [0.5, 0.5], [np.nan, np.nan]])
    replaced = wilson_at_the_ends(intervals, np.full(5, 10.0), 0.95)
    np.testing.assert_allclose(replaced[:2], [[0, 0.2775], [0.7225, 1]], atol=5e-4)
    np.testing.assert_array_equal(replaced[2:], intervals[2:])


@pytest.mark.parametrize("n_scenes", [8, 60])
def test_of_equal_entries_about_one_difference_in_twenty_looks_sure(n_scenes: int) -> None:
    """Differences of whole scenes are as often for the one as for the other."""
    rng = np.random.default_rng(11)
    drawn = rng.multinomial(n_scenes, np.full(n_scenes, 1 / n_scenes), size=1000)
    gaps = rng.choice([-1.0, 1.0], (800, n_scenes)) * rng.beta(1, 3, (800, n_scenes))
    ends = percentile_intervals(gaps @ drawn.T, np.full(800, n_scenes), 0.95)
    is_sure = (ends[:, 0] > 0) | (ends[:, 1] < 0)
    assert 0.03 <= is_sure.mean() <= 0.08
