"""Two entries side by side."""

from typing import Any

import pytest

from exceptiondrive_schemas.board import Board
from exceptiondrive_server.pages.comparison import compare_entries, default_pair, verdict
from exceptiondrive_server.pages.numbers import Digits


def entry(board: Board, method: str) -> Any:
    return next(entry for entry in board.entries if entry.method.startswith(method))


@pytest.mark.parametrize(
    ("a", "b", "words"),
    [
        ("Kestrel", "LaneKeeper", "Their rank intervals overlap"),
        ("Kestrel", "nerve", "the order is sure"),
        ("nerve", "Kestrel", "the order is sure"),
        ("Kestrel", "ST-P3", "At least one of the two is reported"),
        ("Kestrel", "half", "half-a-file has no HCC"),
        ("CONSTANT", "Kestrel", "Their intervals do not overlap"),
    ],
)
def test_the_verdict_never_says_more_than_the_data(
    lively_board: Board, a: str, b: str, words: str
) -> None:
    assert words in verdict(lively_board, entry(lively_board, a), entry(lively_board, b), Digits())


def test_equal_published_values_are_called_equal(lively_board: Board) -> None:
    one = entry(lively_board, "Kestrel")
    assert verdict(lively_board, one, one, Digits()) == "Both stand at 61.40 % HCC."


def test_equal_families_are_called_equal_and_unreported_ones_unknown(
    lively_board: Board, paper_board: Board
) -> None:
    one, unreported = entry(lively_board, "Kestrel"), entry(paper_board, "VAD")
    equal = compare_entries(lively_board, one, one, Digits())
    assert equal.families_sentence == "They are equal in every family."
    unknown = compare_entries(paper_board, unreported, unreported, Digits())
    assert unknown.families_sentence == "No family split is known for both."


def test_differences_are_first_minus_second(paper_board: Board) -> None:
    both = compare_entries(
        paper_board, entry(paper_board, "ST-P3"), entry(paper_board, "Impromptu"), Digits()
    )
    assert [line.difference for line in both.metrics] == [
        "+1.39",
        "\u22120.81",
        "\u22120.28",
        "\u22120.63",
        "\u22120.31",
        "\u22120.46",
    ]
    assert both.chart is not None
    assert [line.difference for line in both.chart.lines][:2] == ["+0.39", "\u22120.42"]
    assert "The widest gap is 6.89 points, in intersection scenes." in both.families_sentence


def test_the_two_best_are_compared_first_and_reported_ones_only_without_scores(
    lively_board: Board, paper_board: Board, empty_board: Board
) -> None:
    best = default_pair(lively_board)
    assert best is not None
    assert [e.rank for e in best] == [1, 2]
    printed = default_pair(paper_board)
    assert printed is not None
    assert [e.method for e in printed] == ["ST-P3", "Impromptu VLA"]
    assert default_pair(empty_board) is None


async def test_the_compare_page_takes_two_keys(lively_site: Any) -> None:
    answer = await lively_site.get("/compare?phase=sample&a=reported-st-p3&b=s0000000kq")
    assert answer.status_code == 200
    assert "ST-P3 against Kestrel-2" in answer.text
    assert (await lively_site.get("/compare?a=unknown")).status_code == 404


async def test_without_a_board_there_is_nothing_to_compare(site: Any) -> None:
    answer = await site.get("/compare")
    assert answer.status_code == 200
    assert "not two entries to compare" in answer.text
