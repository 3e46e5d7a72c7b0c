"""The strategy challenge (docs/protocol.md section 6), by hand."""

from collections.abc import Callable
from itertools import product

import numpy as np
import pytest
from tests.scoring.made import answers_alone

from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_scoring.arrays import STRATEGIES, SplitArrays
from exceptiondrive_scoring.strategy import (
    StrategyAnswers,
    StrategyScoring,
    confusion,
    grade_strategies,
    reminder_scores,
    under_warning_sets,
)

MakeSplit = Callable[..., SplitArrays]
LETTERS = "ABCDE"
SE1, LB1, BG1, RS1 = 0, 4, 8, 18  # acceptable C D | C | B C E | C E


def _answers(letters: str) -> StrategyAnswers:
    return answers_alone(np.array([LETTERS.find(x) for x in letters]))


@pytest.fixture
def split(make_split: MakeSplit) -> Callable[[list[int]], SplitArrays]:
    def make(tasks: list[int]) -> SplitArrays:
        return make_split(np.zeros((len(tasks), 4, 2)), tasks=tasks)

    return make


SplitOf = Callable[[list[int]], SplitArrays]


@pytest.mark.parametrize(
    ("task", "under", "over"),
    [
        (SE1, "ABE", ""),  # least cautious acceptable: D
        (LB1, "ABDE", ""),
        (BG1, "A", "D"),
        (RS1, "AB", "D"),
    ],
)
def test_wrong_answers_are_under_warning_below_the_least_cautious_acceptable_one(
    task: int, under: str, over: str, split: SplitOf, protocol: ProtocolDocument
) -> None:
    split_of_five = split([task] * 5)
    values = grade_strategies(_answers(LETTERS), split_of_five, protocol).values
    acceptable = [s.value for s in protocol.taxonomy.tasks[task].acceptable]
    assert values[:, 0].tolist() == [letter in acceptable for letter in LETTERS]
    assert values[:, 1].tolist() == [letter in under for letter in LETTERS]
    assert values[:, 2].tolist() == [letter in over for letter in LETTERS]
    sets = under_warning_sets(split_of_five.acceptable, protocol.grading)
    assert sets[0].tolist() == [letter in under for letter in LETTERS]


def test_a_missing_answer_is_wrong_and_under_warning_and_counted_apart(
    split: SplitOf, protocol: ProtocolDocument
) -> None:
    scores = grade_strategies(_answers("?C"), split([LB1, LB1]), protocol)
    assert scores.metric_keys == ("accuracy", "under_warning", "over_warning", "missing")
    assert scores.values.tolist() == [[0, 1, 0, 1], [1, 0, 0, 0]]


def test_another_order_of_caution_changes_what_is_under_warning(
    split: SplitOf, protocol: ProtocolDocument
) -> None:
    caution = protocol.grading.caution | {"D": 2, "E": 3}
    grading = protocol.grading.model_copy(update={"caution": caution})
    other = protocol.model_copy(update={"grading": grading})
    answers, one = _answers("E"), split([SE1])
    assert grade_strategies(answers, one, protocol).values[0, 1:3].tolist() == [1, 0]
    assert grade_strategies(answers, one, other).values[0, 1:3].tolist() == [0, 1]


def test_the_confusion_matrix_counts_answers_by_acceptable_set(split: SplitOf) -> None:
    rows = confusion(_answers("CA?E"), split([SE1, SE1, LB1, BG1]))
    none = dict.fromkeys(LETTERS, 0.0)
    assert rows == {
        "CD": none | {"n": 2, "A": 1, "C": 1, "missing": 0},
        "C": none | {"n": 1, "missing": 1},
        "BCE": none | {"n": 1, "E": 1, "missing": 0},
    }


def _with_reminders(
    given: list[bool], present: list[int], types: list[str], recommended: str
) -> StrategyAnswers:
    return StrategyAnswers(
        strategy=np.zeros(len(given), dtype=np.int8),
        reminder_given=np.array(given),
        hazard_present=np.array(present, dtype=np.int8),
        hazard_type=np.array([name.encode() for name in types], dtype="S64"),
        recommended=np.array([LETTERS.find(x) for x in recommended], dtype=np.int8),
    )


def test_reminders_are_scored_over_the_samples_that_carry_one(
    split: SplitOf, protocol: ProtocolDocument
) -> None:
    answers = _with_reminders(
        [True, True, True, False],
        [1, 1, 0, 1],
        ["SE1", "SE2", "", "LB1"],
        "CA?C",
    )
    scores = reminder_scores(answers, split([SE1, SE1, LB1, LB1]), protocol.taxonomy)
    assert scores == pytest.approx(
        {
            "n": 3.0,
            "given": 0.75,
            "presence_precision": 1.0,
            "presence_recall": 2 / 3,
            "type_task_accuracy": 1 / 3,
            "type_family_accuracy": 2 / 3,
            "strategy_accuracy": 1 / 3,
        }
    )


def test_what_a_record_leaves_out_is_wrong_and_no_alarm_is_false(
    split: SplitOf, protocol: ProtocolDocument
) -> None:
    """As docs/protocol.md, docs/submission-format.md and the page of an entry say."""
    answers = _with_reminders([True] * 4, [1, 1, -1, 0], ["SE1", "", "no_such_task", ""], "C???")
    scores = reminder_scores(answers, split([SE1] * 4), protocol.taxonomy)
    assert (scores["presence_precision"], scores["presence_recall"]) == (1.0, 0.5)
    assert scores["type_task_accuracy"] == scores["strategy_accuracy"] == 0.25


def test_without_reminders_nothing_about_them_is_defined(
    split: SplitOf, protocol: ProtocolDocument
) -> None:
    scores = reminder_scores(_answers("CC"), split([SE1, SE1]), protocol.taxonomy)
    assert (scores.pop("n"), scores.pop("given")) == (0.0, 0.0)
    assert set(scores.values()) == {None}


def test_scoring_agrees_with_the_sets_that_the_protocol_stores(protocol: ProtocolDocument) -> None:
    sets = [
        [strategy for strategy, taken in zip(STRATEGIES, bits, strict=True) if taken]
        for bits in product((False, True), repeat=len(STRATEGIES))
        if any(bits)
    ]
    table = np.array([[strategy in chosen for strategy in STRATEGIES] for chosen in sets])
    under = under_warning_sets(table, protocol.grading)
    assert [tuple(s for s, bad in zip(STRATEGIES, row, strict=True) if bad) for row in under] == [
        protocol.grading.under_warning(chosen) for chosen in sets
    ]


@pytest.mark.parametrize(
    ("letters", "told"),
    [
        ("C" * 20 + "-", ["100% of the answers are C."]),
        ("C" * 20 + "A", ["95.2% of the answers are C."]),
        ("C" * 19 + "A", []),
        ("C" * 19, []),
    ],
)
def test_one_strategy_for_nearly_all_of_enough_samples_is_flagged(
    letters: str, told: list[str], split: SplitOf, protocol: ProtocolDocument
) -> None:
    found = StrategyScoring().plausibility(
        _answers(letters).columns(), split([SE1] * len(letters)), protocol
    )
    assert [flag.detail for flag in found.flags] == told
