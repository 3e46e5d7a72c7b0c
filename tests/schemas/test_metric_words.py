"""Metrics in words: with the protocol's digits, and never as minus zero."""

from typing import Any

import pytest

from exceptiondrive_schemas.api.rescoring import Standing
from exceptiondrive_schemas.api.standing_words import ranked_words, standing_words
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


def _standing(**changes: Any) -> Standing:
    values: dict[str, Any] = {"hcc": 0.65472, "ur": 0.2, "hpr": 0.1824, **changes}
    return Standing(rank=3, rank_interval=None, unranked_because=None, metrics=values, families={})


@pytest.mark.parametrize(
    ("old", "new", "more"),
    [
        ({}, {"hpr": 0.1813}, ", HPR 18.13 % (was 18.24 %)"),
        ({}, {"hpr": None}, ", HPR none (was 18.24 %)"),
        ({}, {"cts": 1.0}, ", a number that is not shown here changes"),
        ({}, {"hcc": 0.65474}, ", a number that is not shown here changes"),
        ({"ur": 0.3}, {"hpr": 0.1813}, ""),
    ],
)
def test_what_changes_besides_the_numbers_that_rank_is_named_where_those_stay(
    old: dict[str, Any], new: dict[str, Any], more: str
) -> None:
    """A column that is new has no number before."""
    words = "rank 3, HCC 65.47 %, UR 20.00 %"
    before, now = _standing(**old), _standing(**new)
    assert standing_words(PLANNING, now) == words
    assert standing_words(PLANNING, now, before=before) == words + more


def test_a_share_is_rounded_as_the_board_rounds_it() -> None:
    assert (
        metric_text(HCC, 0.6437499999999999)
        == f"{100 * round(0.6437499999999999, 4):.2f}"
        == "64.37"
    )
