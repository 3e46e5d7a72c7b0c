"""The audit's intervals: the paper's counts, and what the definitions say."""

import math
from statistics import NormalDist

import pytest
from hypothesis import given
from hypothesis import strategies as st

from exceptiondrive_build.numbers import audited, finite_population, wilson

Z = NormalDist().inv_cdf(0.975)


def test_the_counts_of_the_paper() -> None:
    audit = audited(3181, 168, 163)
    assert audit.passed / audit.drawn == pytest.approx(0.9702, abs=5e-5)
    assert audit.drawn / audit.accepted == pytest.approx(0.0528, abs=5e-5)
    assert audit.wilson == pytest.approx((0.9322, 0.9872), abs=5e-5)
    low, high = audit.finite_population
    assert audit.wilson[0] < low < audit.passed / audit.drawn < high < audit.wilson[1]


@given(st.integers(1, 500), st.data())
def test_an_end_is_as_far_as_its_own_spread_allows(n: int, data: st.DataObject) -> None:
    """The score interval: those shares p from which the found one is at most z spreads away."""
    share = data.draw(st.integers(0, n)) / n
    for end in wilson(share, n):
        assert 0 <= end <= 1
        spread = math.sqrt(end * (1 - end) / n)
        assert abs(share - end) == pytest.approx(Z * spread, abs=1e-6)


@given(st.integers(1, 200), st.integers(0, 200), st.data())
def test_a_draw_from_few_is_surer(n: int, more: int, data: st.DataObject) -> None:
    share = data.draw(st.integers(0, n)) / n
    wide, narrow = wilson(share, n), finite_population(share, n, n + more)
    if more == 0:
        assert narrow == (share, share), "who looked at all knows"
    assert wide[0] - 1e-12 <= narrow[0] <= share + 1e-12
    assert share - 1e-12 <= narrow[1] <= wide[1] + 1e-12
