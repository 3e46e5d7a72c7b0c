"""The sentences on top come from the numbers."""

import pytest

from exceptiondrive_schemas.board import Board
from exceptiondrive_schemas.challenges import PLANNING, STRATEGY
from exceptiondrive_server.boards.headline import headline
from exceptiondrive_server.web.numbers import Digits


def with_ur(board: Board, ur: float) -> Board:
    entry = board.entries[0]
    metrics = {**entry.metrics, "ur": ur}
    return board.model_copy(update={"entries": (entry.model_copy(update={"metrics": metrics}),)})


@pytest.mark.parametrize(
    ("ur", "title"),
    [
        (1.0, "No planner keeps clear of the hazard yet."),
        (0.78, "Even the safest planner meets the hazard 7 times in 9."),
        (0.5, "The safest planner still meets one hazard in 2."),
        (0.311, "The safest planner still meets 3 hazards in 10."),
        (0.02, "The safest planner keeps clear 98 times in 100."),
    ],
)
def test_the_title_follows_the_lowest_unsafe_rate(
    lively_board: Board, ur: float, title: str
) -> None:
    assert headline(with_ur(lively_board, ur), PLANNING, 21, Digits()).title == title


def test_reference_and_reported_rows_never_make_the_headline(lively_board: Board) -> None:
    facts = {fact.label: fact for fact in headline(lively_board, PLANNING, 21, Digits()).facts}
    assert facts["Highest HCC"].note == "Kestrel-2"
    assert facts["Planners"].note == "ranked, 7 reported"


def test_without_a_score_the_paper_is_quoted_as_the_paper(paper_board: Board) -> None:
    said = headline(paper_board, PLANNING, 21, Digits())
    assert said.title == "Which planner keeps clear of the hazard?"
    assert said.findings[0] == "Nobody has been scored on this board yet."
    assert said.findings[1].startswith("Of the 7 planners in the paper, ST-P3 reaches")


def test_without_a_board_nothing_is_claimed() -> None:
    said = headline(None, PLANNING, 21, Digits())
    assert said.facts == ()
    assert "%" not in " ".join(said.findings)


def test_the_strategy_challenge_is_said_in_its_own_words(strategy_board: Board) -> None:
    said = headline(strategy_board, STRATEGY, 21, Digits())
    assert said.title == "Even the most careful agent warns too little 2 times in 7."
    assert "planner" not in " ".join(said.findings)
    assert [fact.label for fact in said.facts] == [
        "Samples scored",
        "Tasks",
        "Agents",
        "Highest Accuracy",
        "Lowest Under-warning",
    ]
    assert said.facts[0].note == "edited scenes"
    assert headline(None, STRATEGY, 21, Digits()).title == "Which agent is careful enough?"
