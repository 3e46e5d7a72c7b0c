"""How numbers are written."""

from datetime import UTC, datetime
from decimal import ROUND_HALF_UP, Decimal
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from tests.server.pages.invented_board import PROTOCOL

from exceptiondrive_schemas.board import Board
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.printable import counted
from exceptiondrive_schemas.protocol import packaged_protocol
from exceptiondrive_schemas.score_sheet import metric_text
from exceptiondrive_server.boards.query import BoardQuery
from exceptiondrive_server.boards.table import board_table
from exceptiondrive_server.web.numbers import (
    Digits,
    day,
    fixed,
    grouped,
    listed,
    minute,
    percent,
    short_digest,
    size_text,
    slug,
)

HCC, CTS = PLANNING.metric("hcc"), PLANNING.metric("cts")


def test_fractions_are_written_as_per_cent_and_shifts_in_metres() -> None:
    assert Digits().text(HCC, 0.2103) == "21.03"
    assert Digits().text(CTS, 1.5666) == "1.57"
    assert Digits(percent=1).text(HCC, 0.2103) == "21.0"


def test_an_undefined_value_stays_undefined() -> None:
    assert Digits().text(HCC, None) is None


@pytest.mark.parametrize(
    ("value", "interval", "text"),
    [
        (0.613, (0.57, 0.65), "\u00b14.3"),
        (0.809, (0.625, 0.899), "\u221218.4 +9.0"),
        (0.995, (0.875, 1.0), "\u221212.0 +0.5"),
        (0.11, (0.0, 0.265), "\u221211.0 +15.5"),
        (0.92, (0.83, 1.0), "\u22129.0 +8.0"),
        (0.9, (0.8, 1.0), "\u00b110.0"),
        (0.9904, (0.98, 1.0), "\u00b11.0"),
        (1.0, (0.969, 1.0), "\u22123.1"),
        (0.0, (0.0, 0.031), "+3.1"),
        (0.5, (0.5, 0.5), "\u00b10.0"),
    ],
)
def test_no_interval_is_written_to_reach_beyond_what_a_share_can_be(
    value: float, interval: tuple[float, float], text: str
) -> None:
    assert Digits().spread(HCC, value, interval) == text


def test_a_shift_has_no_bound_to_reach_beyond() -> None:
    assert Digits().spread(CTS, 1.5, (0.1, 2.6)) == "\u00b11.40"


@pytest.mark.parametrize(
    ("difference", "text"),
    [(0.0139, "+1.39"), (-0.0081, "\u22120.81"), (0.0, "0.00"), (-0.00001, "0.00")],
)
def test_differences_carry_a_real_minus_sign_and_zero_carries_none(
    difference: float, text: str
) -> None:
    assert Digits().signed(HCC, difference) == text


@given(value=st.floats(-2, 2), decimals=st.integers(0, 4))
@example(value=0.6437499999999999, decimals=2)
@example(value=0.125, decimals=2)
def test_a_command_writes_what_was_not_rounded_as_a_page_what_was(
    value: float, decimals: int
) -> None:
    digits = {"percent_decimals": decimals, "metre_decimals": decimals}
    publication = packaged_protocol().publication.model_copy(update=digits)
    for metric in PLANNING.metrics:
        told = metric_text(metric, value, publication)
        published = round(value, decimals + 2 * (metric.unit == "fraction"))
        assert Digits.of(publication).text(metric, published) == told.replace("-", "\u2212")


def test_a_share_that_somebody_set_keeps_the_decimals_that_it_has() -> None:
    assert [percent(share) for share in (0.95, 0.57, 0.995)] == [
        f"{text}\u202f%" for text in ("95", "57", "99.5")
    ]


def test_minus_zero_is_written_as_zero() -> None:
    assert fixed(-0.0001, 2) == "0.00"
    assert fixed(-1.5, 1) == "\u22121.5"


@given(steps=st.integers(-10_000, 10_000))
def test_fewer_decimals_than_are_published_are_those_of_the_published_text(steps: int) -> None:
    share, published = steps / 10_000, Decimal(steps) / 100
    for decimals in (0, 1, 2):
        exact = published.quantize(Decimal(1).scaleb(-decimals), ROUND_HALF_UP) + 0
        assert fixed(share * 100, decimals) == str(exact).replace("-", "\u2212")


def test_counts_lists_and_sizes_read_like_a_sentence() -> None:
    assert grouped(3181) == "3,181"
    assert (counted(1, "entry", "entries"), counted(2, "entry", "entries")) == (
        "1 entry",
        "2 entries",
    )
    assert listed(["a", "b", "c"]) == "a, b and c"
    assert [size_text(n) for n in (812, 41_233, 2_000_000)] == ["812 bytes", "41.2 kB", "2.0 MB"]
    assert [size_text(n) for n in (999, 999_949, 999_950)] == ["999 bytes", "999.9 kB", "1.0 MB"]


def test_names_become_plain_addresses() -> None:
    assert slug("ST-P3") == "st-p3"
    assert slug("Møller–Ruiz <b>") == "m-ller-ruiz-b"
    assert slug("車") == "entry"


def test_moments_are_written_in_utc() -> None:
    at = datetime(2026, 11, 1, 9, 5, tzinfo=UTC)
    assert (day(at), minute(at)) == ("1 Nov 2026", "1 Nov 2026, 09:05 UTC")
    assert short_digest("sha256:" + "ab" * 32) == "abababababab"


def test_an_interval_of_whole_per_cents_claims_no_decimals() -> None:
    digits, hcc, cts = Digits(), PLANNING.metric("hcc"), PLANNING.metric("cts")
    assert digits.interval(hcc, (0.23, 0.26)) == "23 to 26"
    assert digits.interval(hcc, (0.29, 0.58)) == "29 to 58"
    assert digits.interval(hcc, (0.23, 0.2601)) == "23.00 to 26.01"
    assert digits.interval(hcc, (-0.03, 0.05), signed=True) == "−3 to +5"
    assert digits.interval(cts, (1.0, 2.0)) == "1.00 to 2.00"
    assert digits.interval(hcc, None) == ""


def test_an_interval_of_whole_per_cents_has_the_decimals_of_those_beside_it() -> None:
    digits, hcc = Digits(has_fine_intervals=True), PLANNING.metric("hcc")
    assert digits.interval(hcc, (0.5, 1.0)) == "50.00 to 100.00"
    assert digits.interval(hcc, (-0.03, 0.05), signed=True) == "−3.00 to +5.00"


def test_a_board_tells_whether_its_intervals_have_decimals(lively_board: Board) -> None:
    first, second = lively_board.entries[:2]
    whole = {"hcc": (0.5, 1.0), "ur": None, "cts": (0.123, 0.456)}
    fine = {"hcc": (0.4286, 0.9231)}

    def shown(*intervals: Any) -> list[Any]:
        entries = (
            entry.model_copy(update={"intervals": each})
            for entry, each in zip((first, second), intervals, strict=True)
        )
        board = lively_board.model_copy(update={"entries": tuple(entries)})
        rows = board_table(board, PROTOCOL, BoardQuery()).rows
        return [row.cells[0].words.split("interval ")[1] for row in rows]

    assert shown(whole, whole) == ["50 to 100", "50 to 100"]
    assert shown(whole, fine) == ["50.00 to 100.00", "42.86 to 92.31"]


def test_intervals_of_families_alone_have_the_same_decimals(lively_board: Board) -> None:
    """The mean of families has none where one of them has few scenes; the others' stand beside each other."""
    entry = lively_board.entries[0]

    def board(**intervals: Any) -> Board:
        cells = {
            key: cell.model_copy(update={"intervals": intervals})
            for key, cell in entry.families.items()
        }
        one = entry.model_copy(update={"intervals": {"hcc": None}, "families": cells})
        return lively_board.model_copy(update={"entries": (one,)})

    assert board(hcc=(0.4286, 1.0)).has_fine_intervals
    assert not board(hcc=(0.5, 1.0)).has_fine_intervals
