"""The strategy challenge: answers A to E against acceptable sets (docs/protocol.md section 6)."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from exceptiondrive_schemas.challenges import STRATEGY
from exceptiondrive_schemas.check import CheckedDocument, StrategyAnswer, StrategyDocument
from exceptiondrive_schemas.printable import share_past
from exceptiondrive_schemas.protocol import GeometrySection, GradingSection, ProtocolDocument
from exceptiondrive_schemas.score_sheet import REMINDER, MetricRow, Plausibility
from exceptiondrive_schemas.submission_files import ReminderRecord
from exceptiondrive_schemas.taxonomy import Strategy, Taxonomy
from exceptiondrive_scoring.aliases import BoolArray, Columns, FloatArray, IntArray
from exceptiondrive_scoring.arrays import STRATEGIES, SplitArrays, family_of_task
from exceptiondrive_scoring.challenge import ChallengeScoring
from exceptiondrive_scoring.grade import SampleScores, sample_scores
from exceptiondrive_scoring.plausibility import raised, share_of
from exceptiondrive_scoring.similarity import AlikeRule

NO_ANSWER = -1
STRATEGY_CODE: dict[Strategy | None, int] = {s: code for code, s in enumerate(STRATEGIES)}
STRATEGY_CODE[None] = NO_ANSWER
PRESENCE_CODE: dict[bool | None, int] = {True: 1, False: 0, None: NO_ANSWER}
NOTHING_SAID = ReminderRecord()


@dataclass(frozen=True)
class StrategyAnswers:
    """One answer per sample, and the contents of its reminder record; all arrays (N,).

    Attributes:
        strategy: int8, 0..4 for A..E, -1 where missing.
        reminder_given: Whether a reminder record came with the answer.
        hazard_present: int8, 1 yes, 0 no, -1 not said.
        hazard_type: Task id as bytes (S64), empty where not said.
        recommended: int8, 0..4 for A..E, -1 where not said.
    """

    strategy: NDArray[np.int8]
    reminder_given: BoolArray
    hazard_present: NDArray[np.int8]
    hazard_type: NDArray[np.bytes_]
    recommended: NDArray[np.int8]

    @classmethod
    def from_columns(cls, columns: Columns) -> "StrategyAnswers":
        """Read what `columns` wrote."""
        return cls(**{field.name: columns[field.name] for field in fields(cls)})

    def columns(self) -> Columns:
        """Return what a store keeps: one array per attribute."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


def under_warning_sets(acceptable: BoolArray, grading: GradingSection) -> BoolArray:
    """Which answers A..E warn too little: less cautious than every acceptable one; (N, 5)."""
    caution = np.array([grading.caution[strategy.value] for strategy in STRATEGIES])  # (5,)
    least = np.where(acceptable, caution, caution.max() + 1).min(axis=1)
    under: BoolArray = ~acceptable & (caution < least[:, None])
    return under


def grade_strategies(
    answers: StrategyAnswers, split: SplitArrays, protocol: ProtocolDocument
) -> SampleScores:
    """Accuracy, under-warning, over-warning and missing of every sample.

    A missing answer is wrong and under-warning, and is also counted separately.
    """
    missing = answers.strategy == NO_ANSWER
    under_set = under_warning_sets(split.acceptable, protocol.grading)
    correct = _look_up(split.acceptable, answers.strategy) & ~missing
    under = _look_up(under_set, answers.strategy) | missing
    by_key = {
        "accuracy": correct,
        "under_warning": under,
        "over_warning": ~correct & ~under,
        "missing": missing,
    }
    return sample_scores(STRATEGY.metrics, by_key)


def confusion(answers: StrategyAnswers, split: SplitArrays) -> dict[str, dict[str, float | None]]:
    """Count answers by acceptable set: `{"CD": {"n": 3, "A": 1, ..., "missing": 0}}`.

    The truth of a sample is a set of strategies, so the rows are the sets that occur.
    """
    power = 1 << np.arange(len(STRATEGIES))
    codes = split.acceptable @ power
    rows: dict[str, dict[str, float | None]] = {}
    for code in np.unique(codes):
        chosen = answers.strategy[codes == code]
        name = "".join(s.value for s, bit in zip(STRATEGIES, power, strict=True) if code & bit)
        row: dict[str, float | None] = {"n": float(len(chosen))}
        row |= {s.value: float(np.sum(chosen == i)) for i, s in enumerate(STRATEGIES)}
        rows[name] = row | {"missing": float(np.sum(chosen == NO_ANSWER))}
    return rows


def _look_up(table: BoolArray, strategy: IntArray) -> BoolArray:
    """Return the value in each row's own column; for a missing answer it is meaningless."""
    chosen: BoolArray = np.take_along_axis(table, np.maximum(strategy, 0)[:, None], axis=1)[:, 0]
    return chosen


def reminder_scores(
    answers: StrategyAnswers, split: SplitArrays, taxonomy: Taxonomy
) -> dict[str, float | None]:
    """Score the contents of the reminder records, over the samples that carry one.

    A field that a record leaves out counts as wrong: an unnamed type is no hit, and an unstated
    presence is no alarm. Every sample that counts has its hazard, so no alarm is false.

    Returns:
        `n` (samples with a record; if few, the row is withheld like that of a small task),
        `given` (their share), `presence_precision`, `presence_recall`, `type_task_accuracy`,
        `type_family_accuracy`, `strategy_accuracy`; None where undefined.
    """
    given = answers.reminder_given
    alarm = answers.hazard_present == PRESENCE_CODE[True]
    task = _task_positions(answers, taxonomy)
    named = task != NO_ANSWER
    family = split.family_index == family_of_task(taxonomy)[task]
    recommended = np.maximum(answers.recommended, 0)[:, None].astype(np.intp)
    fits = np.take_along_axis(split.acceptable, recommended, axis=1)[:, 0]
    return {
        "n": float(np.count_nonzero(given)),
        "given": share_of(given, np.ones_like(given)),
        "presence_precision": share_of(alarm, given & alarm),
        "presence_recall": share_of(alarm, given),
        "type_task_accuracy": share_of(task == split.task_index, given),
        "type_family_accuracy": share_of(family & named, given),
        "strategy_accuracy": share_of(fits & (answers.recommended != NO_ANSWER), given),
    }


def _task_positions(answers: StrategyAnswers, taxonomy: Taxonomy) -> IntArray:
    """Position of each named hazard type in the taxonomy, -1 where it is not one of its tasks."""
    position = {task.id.encode(): index for index, task in enumerate(taxonomy.tasks)}
    named, inverse = np.unique(answers.hazard_type, return_inverse=True)
    return np.array([position.get(bytes(name), NO_ANSWER) for name in named])[inverse]


def strategy_answers(answers: Sequence[StrategyAnswer]) -> StrategyAnswers:
    """Return answers and reminders as arrays, in the same order."""
    said = [answer.reminder or NOTHING_SAID for answer in answers]
    return StrategyAnswers(
        strategy=np.array([STRATEGY_CODE[each.strategy] for each in answers], dtype=np.int8),
        reminder_given=np.array([each.reminder is not None for each in answers], dtype=np.bool_),
        hazard_present=np.array([PRESENCE_CODE[r.hazard_present] for r in said], dtype=np.int8),
        hazard_type=np.array([(r.hazard_type or "").encode() for r in said], dtype="S64"),
        recommended=np.array([STRATEGY_CODE[r.recommended_strategy] for r in said], dtype=np.int8),
    )


def _letters(answers: Columns) -> FloatArray:
    letters = np.asarray(answers["strategy"], dtype=np.float64)
    return np.where(letters == NO_ANSWER, np.nan, letters)[:, None, None]


class StrategyScoring(ChallengeScoring):
    """Answers A to E against acceptable sets; controls are not scored, they are about progress."""

    challenge = STRATEGY
    alike: ClassVar[AlikeRule] = AlikeRule(
        _letters, tolerance=0.0, equal_share=0.995, mean_distance=None, probe_share=0.99
    )

    def columns(self, document: CheckedDocument, sample_ids: Sequence[str]) -> Columns:
        """The answers of a sound file."""
        assert isinstance(document, StrategyDocument)
        return strategy_answers([document.answers[each] for each in sample_ids]).columns()

    def measure(self, answers: Columns, split: SplitArrays, geometry: GeometrySection) -> Columns:
        """Answers need no geometry: they are their own measurements."""
        return answers

    def grade(
        self, measurements: Columns, split: SplitArrays, protocol: ProtocolDocument
    ) -> SampleScores:
        """Accuracy, under-warning, over-warning and missing of each sample."""
        return grade_strategies(StrategyAnswers.from_columns(measurements), split, protocol)

    def coverage(self, measurements: Columns) -> dict[str, float | None]:
        """Share of samples answered."""
        return {"edited": float(np.mean(measurements["strategy"] != NO_ANSWER)), "source": None}

    def plausibility(
        self, measurements: Columns, split: SplitArrays, protocol: ProtocolDocument
    ) -> Plausibility:
        """Share of the most frequent strategy among the answers, and its flag."""
        given = measurements["strategy"][measurements["strategy"] != NO_ANSWER]
        if not len(given):
            return Plausibility(shares={"same_answer": None})
        counts = np.bincount(given, minlength=len(STRATEGIES))
        share = int(counts.max()) / len(given)
        section = protocol.plausibility
        is_flagged = (
            share > section.flag_same_answer and len(given) >= section.flag_family_min_samples
        )
        letter = STRATEGIES[int(counts.argmax())].value
        said = share_past(share, section.flag_same_answer)
        flag = raised("same_answer", f"{said} of the answers are {letter}.")
        return Plausibility(shares={"same_answer": share}, flags=(flag,) if is_flagged else ())

    def extra(
        self, measurements: Columns, split: SplitArrays, protocol: ProtocolDocument
    ) -> dict[str, MetricRow]:
        """Confusion by acceptable set, and the reminder's scores if records were given."""
        answers = StrategyAnswers.from_columns(measurements)
        rows = {f"confusion_{name}": row for name, row in confusion(answers, split).items()}
        if answers.reminder_given.any():
            rows[REMINDER] = reminder_scores(answers, split, protocol.taxonomy)
        return rows
