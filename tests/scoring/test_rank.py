"""Ranks: by the protocol's order, ties shared."""

import pytest

from exceptiondrive_schemas.challenges import RankKey
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.score_sheet import MetricRow
from exceptiondrive_scoring.rank import ranks


@pytest.fixture
def order(protocol: ProtocolDocument) -> tuple[RankKey, ...]:
    return protocol.ranking.order["planning"]


def rows(hcc: list[float | None], ur: list[float | None]) -> list[MetricRow]:
    return [{"hcc": one, "ur": other} for one, other in zip(hcc, ur, strict=True)]


def test_higher_hcc_ranks_first_and_lower_ur_breaks_ties(order: tuple[RankKey, ...]) -> None:
    values = rows([10.37, 21.03, 19.64, 19.64], [81.93, 78.11, 80.0, 78.92])
    assert ranks(values, [True] * 4, order) == [4, 1, 3, 2]


@pytest.mark.row("I33")
def test_equal_entries_share_a_rank_and_the_next_rank_is_skipped(
    order: tuple[RankKey, ...],
) -> None:
    values = rows([5.0, 9.0, 5.0, 1.0], [70.0, 70.0, 70.0, 70.0])
    assert ranks(values, [True] * 4, order) == [2, 1, 2, 4]


@pytest.mark.row("I33")
def test_a_difference_below_every_printed_digit_is_still_a_difference(
    order: tuple[RankKey, ...],
) -> None:
    values = rows([5.0, 5.0 + 1e-12, 5.0], [70.0, 70.0, 70.0 - 1e-12])
    assert ranks(values, [True] * 3, order) == [3, 1, 2]


def test_an_undefined_score_does_not_rank_and_takes_no_rank(order: tuple[RankKey, ...]) -> None:
    assert ranks(rows([None, 9.0], [1.0, 70.0]), [True, True], order) == [None, 1]
    assert ranks(rows([10.0, 9.0], [None, 70.0]), [True, True], order) == [None, 1]


def test_an_entry_that_answers_too_little_does_not_rank(order: tuple[RankKey, ...]) -> None:
    values = rows([30.0, 9.0], [60.0, 70.0])
    assert ranks(values, [False, True], order) == [None, 1]


def test_an_empty_board_has_no_ranks(order: tuple[RankKey, ...]) -> None:
    assert ranks(rows([], []), [], order) == []


def test_zero_is_a_score(order: tuple[RankKey, ...]) -> None:
    assert ranks(rows([0.0, 0.0], [100.0, 100.0]), [True, True], order) == [1, 1]
