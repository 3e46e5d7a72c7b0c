"""Scales with round ticks."""

import math

from hypothesis import given
from hypothesis import strategies as st

from exceptiondrive_server.web.numbers import fixed, nice_scale, px

values = st.lists(st.floats(0, 100, allow_nan=False), min_size=1, max_size=20)


@given(values)
def test_every_value_lies_inside_the_domain_and_ticks_too(known: list[float]) -> None:
    scale = nice_scale(known, (0, 640), floor=0, ceiling=100)
    assert all(scale.holds(value) or math.isclose(value, scale.domain[0]) for value in known)
    assert all(scale.domain[0] - 1e-9 <= tick <= scale.domain[1] + 1e-9 for tick in scale.ticks)
    assert scale.domain[0] < scale.domain[1]


@given(values)
def test_ticks_are_few_and_written_apart(known: list[float]) -> None:
    scale = nice_scale(known, (0, 640))
    texts = [fixed(tick, scale.tick_decimals) for tick in scale.ticks]
    assert 2 <= len(texts) <= 9
    assert len(set(texts)) == len(texts)


def test_a_scale_maps_ends_to_ends_and_holds_strangers_inside() -> None:
    scale = nice_scale([0.0, 75.0], (100, 200))
    assert (scale.at(scale.domain[0]), scale.at(scale.domain[1])) == (100, 200)
    assert scale.clamped(1000) == 200


def test_a_falling_extent_turns_the_axis_round() -> None:
    scale = nice_scale([0, 10], (300, 0))
    assert scale.at(0) == 300
    assert scale.at(10) == 0


def test_coordinates_are_short() -> None:
    assert [px(value) for value in (12.0, 0.04, -0.01, 3.25)] == ["12", "0", "0", "3.2"]
