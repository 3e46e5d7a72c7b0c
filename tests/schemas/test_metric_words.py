"""Metrics in words: with the protocol's digits, and never as minus zero."""

import pytest

from exceptiondrive_schemas.api.standing_words import ranked_words
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.protocol import packaged_protocol
from exceptiondrive_schemas.score_sheet import metric_text

PUBLISHED = packaged_protocol().publication
FINE = PUBLISHED.model_copy(update={"percent_decimals": 3, "metre_decimals": 1})
HCC, CTS = PLANNING.metric("hcc"), PLANNING.metric("cts")


@pytest.mark.parametrize("value", [-0.00001, -0.0, 0.0])
def test_what_rounds_to_zero_is_zero(value: float) -> None:
    assert metric_text(HCC, value) == metric_text(CTS, value) == "0.00"
    assert metric_text(HCC, -0.5) == "-50.00"


def test_digits_are_those_of_the_protocol() -> None:
    assert (metric_text(HCC, 0.12345), metric_text(HCC, 0.12345, FINE)) == ("12.35", "12.345")
    assert (metric_text(CTS, 1.26), metric_text(CTS, 1.26, FINE)) == ("1.26", "1.3")
    values = {"hcc": 0.65472, "ur": 0.2}
    intervals = {"hcc": (0.63001, 0.68), "ur": (0.1, 0.3)}
    assert [*ranked_words(PLANNING, values, intervals, FINE)] == [
        "HCC 65.472 % (63.001 to 68.000)",
        "UR 20.000 % (10 to 30)",
    ]
    assert next(ranked_words(PLANNING, values, intervals)) == "HCC 65.47 % (63.00 to 68.00)"


def test_a_share_is_rounded_as_the_board_rounds_it() -> None:
    assert (
        metric_text(HCC, 0.6437499999999999)
        == f"{100 * round(0.6437499999999999, 4):.2f}"
        == "64.37"
    )
