"""Both challenges through the one interface that callers use."""

from collections.abc import Callable

import numpy as np
import pytest
from tests.scoring.made import answers_alone

from exceptiondrive_schemas.challenges import CHALLENGES, PLANNING, STRATEGY, ChallengeId
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.split import SplitRef
from exceptiondrive_scoring.aliases import Columns
from exceptiondrive_scoring.arrays import SplitArrays
from exceptiondrive_scoring.challenge import ChallengeScoring, exact_sheet, scoring_of
from exceptiondrive_scoring.planning import PlanningScoring
from exceptiondrive_scoring.plausibility import OfControls, raised
from exceptiondrive_scoring.sheet import aggregate
from exceptiondrive_scoring.strategy import StrategyScoring

MakeSplit = Callable[..., SplitArrays]
N = 6
CLASSES: tuple[type[ChallengeScoring], ...] = (PlanningScoring, StrategyScoring)
"""mypy holds them to the interface: they are registered by their names."""


def _answers(challenge_id: ChallengeId) -> Columns:
    drive = np.cumsum(np.full((N, 6, 2), [2.0, 0.1]), axis=1)
    drive[0] = np.nan
    strategies = answers_alone(np.array([-1, 2, 2, 2, 2, 2]))
    answers: dict[ChallengeId, Columns] = {
        PLANNING.id: {"source": drive.copy(), "edited": drive},
        STRATEGY.id: strategies.columns(),
    }
    return answers[challenge_id]


@pytest.fixture
def split(make_split: MakeSplit) -> SplitArrays:
    corners = np.array([[9.0, -1.0], [10.0, -1.0], [10.0, 1.0], [9.0, 1.0]])
    return make_split(np.tile(corners, (N, 1, 1)), tasks=[0, 4, 8, 12, 15, 18])


def test_every_challenge_is_scored_by_a_class_of_its_own() -> None:
    assert [type(scoring_of(challenge_id)) for challenge_id in CHALLENGES] == list(CLASSES)


@pytest.mark.parametrize("challenge_id", list(CHALLENGES))
def test_every_challenge_goes_the_same_way_to_a_sheet(
    challenge_id: ChallengeId, split: SplitArrays, protocol: ProtocolDocument
) -> None:
    scoring = scoring_of(challenge_id)
    assert scoring.challenge == CHALLENGES[challenge_id]
    measurements = scoring.measure(_answers(challenge_id), split, protocol.geometry)
    assert all(len(column) == N for column in measurements.values())
    scores = scoring.grade(measurements, split, protocol)
    assert scores.metric_keys == CHALLENGES[challenge_id].metric_keys
    assert scores.values.shape == (N, len(scores.metric_keys))
    sheet = aggregate(scores, split, protocol.taxonomy)
    assert set(sheet.micro) == set(scores.metric_keys)
    assert scoring.coverage(measurements)["edited"] == pytest.approx(5 / 6)
    scoring.plausibility(measurements, split, protocol)
    scoring.extra(measurements, split, protocol)


@pytest.mark.parametrize("challenge_id", list(CHALLENGES))
def test_measuring_changes_none_of_its_inputs(
    challenge_id: ChallengeId, split: SplitArrays, protocol: ProtocolDocument
) -> None:
    answers = _answers(challenge_id)
    before = {key: column.copy() for key, column in answers.items()}
    for column in (*answers.values(), split.regions_m, split.d_safe_m):
        column.setflags(write=False)
    scoring = scoring_of(challenge_id)
    measurements = scoring.measure(answers, split, protocol.geometry)
    for column in measurements.values():
        column.setflags(write=False)
    scoring.grade(measurements, split, protocol)
    for key, column in before.items():
        np.testing.assert_array_equal(answers[key], column)


def test_the_strategy_sheet_carries_confusion_and_reminder_rows(
    split: SplitArrays, protocol: ProtocolDocument
) -> None:
    scoring = scoring_of(STRATEGY.id)
    answers = _answers(STRATEGY.id)
    assert "reminder" not in scoring.extra(answers, split, protocol)
    reminded = {**answers, "reminder_given": np.ones(N, dtype=np.bool_)}
    rows = scoring.extra(reminded, split, protocol)
    assert rows["confusion_CD"]["missing"] == 1
    assert rows["reminder"]["given"] == 1.0


@pytest.mark.parametrize(("challenge_id", "n_source"), [(PLANNING.id, 5), (STRATEGY.id, None)])
def test_a_sheet_counts_what_was_answered_and_has_the_flags_of_samples_and_of_controls(
    challenge_id: ChallengeId,
    n_source: int | None,
    split: SplitArrays,
    protocol: ProtocolDocument,
) -> None:
    scoring, ref = scoring_of(challenge_id), SplitRef(name="six", revision="sha256:" + "0" * 64)
    measured = scoring.measure(_answers(challenge_id), split, protocol.geometry)
    of_controls = OfControls(
        {"over_caution": 1.0}, (raised("over_cautious", "All are held back."),)
    )
    sheet = exact_sheet(scoring, measured, split, ref, protocol, of_controls)
    assert (sheet.coverage.n_edited, sheet.coverage.n_source) == (5, n_source)
    assert sheet.micro["over_caution"] == 1.0
    of_samples = scoring.plausibility(measured, split, protocol).flags
    assert sheet.plausibility.flags == (*of_samples, *of_controls.flags)
