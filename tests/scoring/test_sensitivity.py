"""HCC with other required clearances, from clearances worked by hand."""

from collections.abc import Callable

import numpy as np
import pytest

from exceptiondrive_schemas.protocol import (
    ProtocolDocument,
    ProtocolError,
    packaged_protocol_toml,
    parse_protocol,
)
from exceptiondrive_scoring.arrays import SplitArrays, TrajectoryPairs
from exceptiondrive_scoring.grade import grade
from exceptiondrive_scoring.measure import Measurements, measure
from exceptiondrive_scoring.planning import clearance_sensitivity
from exceptiondrive_scoring.sheet import aggregate

MakeSplit = Callable[..., SplitArrays]
FRONT = 3.528
SE1, LB4 = 0, 7
"""Positions of two tasks: 2 m and 1 m are asked for, in two families."""


def _walls_ahead(distances_m: list[float]) -> np.ndarray:
    corners = [[0.0, -3.0], [2.0, -3.0], [2.0, 3.0], [0.0, 3.0]]
    return np.array([[[x + FRONT + far, y] for x, y in corners] for far in distances_m])


@pytest.fixture
def split(make_split: MakeSplit) -> SplitArrays:
    return make_split(_walls_ahead([1.0, 1.0, 0.2]), tasks=[SE1, LB4, LB4])


def _standing(split: SplitArrays, protocol: ProtocolDocument) -> Measurements:
    still = np.zeros((split.n_samples, 6, 2))
    pairs = TrajectoryPairs.from_columns({"source": still, "edited": still})
    return measure(pairs, split.regions_m, protocol.geometry)


def test_half_and_twice_the_required_clearance_by_hand(
    split: SplitArrays, protocol: ProtocolDocument
) -> None:
    rows = clearance_sensitivity(_standing(split, protocol), split, protocol)
    assert list(rows) == ["d_safe_x0.5", "d_safe_x2"]
    half, twice = rows.values()
    assert half["hcc_micro"] == pytest.approx((1 + 1 + 0.4) / 3)
    assert half["hcc_macro_family"] == pytest.approx((1 + 0.7) / 2)
    assert twice["hcc_micro"] == pytest.approx((0.25 + 0.5 + 0.1) / 3)
    assert twice["hcc_macro_family"] == pytest.approx((0.25 + 0.3) / 2)


def test_a_row_says_what_a_protocol_with_that_scale_would_rank_by(
    split: SplitArrays, protocol: ProtocolDocument
) -> None:
    measured = _standing(split, protocol)
    for factor in protocol.grading.sensitivity_factors:
        scaled = protocol.model_copy(
            update={"grading": protocol.grading.model_copy(update={"d_safe_scale": factor})}
        )
        whole = aggregate(grade(measured, split, scaled), split, protocol.taxonomy)
        row = clearance_sensitivity(measured, split, protocol)[f"d_safe_x{factor:g}"]
        expected = {"hcc_micro": whole.micro, "hcc_macro_family": whole.macro_family}
        assert row == {key: means["hcc"] for key, means in expected.items()}


def test_a_protocol_may_ask_for_no_sensitivity_but_not_twice_for_the_same() -> None:
    toml = packaged_protocol_toml()
    without = toml.replace("sensitivity_factors = [0.5, 2.0]", "sensitivity_factors = []")
    assert parse_protocol(without).grading.sensitivity_factors == ()
    with pytest.raises(ProtocolError, match="differ"):
        parse_protocol(toml.replace("[0.5, 2.0]", "[0.5, 0.5]"))
