"""What a sound file gives, and that every fault of a file is found in one pass."""

import copy
import gzip
import json
import math
from collections.abc import Callable
from typing import Any

import pytest

from exceptiondrive_schemas.challenges import PLANNING, ChallengeId
from exceptiondrive_schemas.check import PlanningDocument, StrategyDocument, check
from exceptiondrive_schemas.faults import FaultCode, FaultGroup
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.split import Manifest

Encode = Callable[[Any], bytes]


@pytest.fixture
def encoded() -> Callable[[Any], bytes]:
    def encode(document: Any) -> bytes:
        return json.dumps(document).encode()

    return encode


@pytest.fixture
def faults(protocol: ProtocolDocument, manifest: Manifest, encoded: Encode) -> Callable[[Any], Any]:
    def check_object(document: Any) -> dict[FaultCode, FaultGroup]:
        data = document if isinstance(document, bytes) else encoded(document)
        report = check(data, protocol=protocol, manifest=manifest).report
        return {group.code: group for group in report.faults}

    return check_object


def test_a_sound_planning_file_gives_its_trajectories(
    planning: dict[str, Any], protocol: ProtocolDocument, manifest: Manifest, encoded: Encode
) -> None:
    planning["predictions"][1]["edited"] = None
    checked = check(encoded(planning), protocol=protocol, manifest=manifest)
    assert checked.report.is_valid
    assert checked.report.challenge == "planning"
    assert checked.report.n_predictions == 3
    assert isinstance(checked.document, PlanningDocument)
    columns = checked.document.columns(manifest.sample_ids)
    assert list(columns["source"][:4]) == [1.5, 0.0, 3.0, 0.0]
    is_missing = [math.isnan(value) for value in columns["edited"]]
    assert is_missing == [False] * 12 + [True] * 12 + [False] * 12


def test_a_step_too_tiny_to_be_squared_is_no_way(
    planning: dict[str, Any], faults: Callable[[Any], dict[FaultCode, FaultGroup]]
) -> None:
    planning["predictions"][0]["source"][0] = [1e-200, 0.0]
    assert faults(planning) == {}


@pytest.mark.parametrize(
    ("n_seen", "unranked", "noted", "refused"),
    [(0, (), True, False), (1, (), False, False), (0, ("blind_to_the_edit",), False, True)],
)
def test_a_file_that_reacts_to_no_hazard_is_told_its_flag(
    planning: dict[str, Any],
    protocol: ProtocolDocument,
    manifest: Manifest,
    encoded: Encode,
    n_seen: int,
    unranked: tuple[str, ...],
    noted: bool,
    refused: bool,
) -> None:
    for prediction in planning["predictions"][:n_seen]:
        prediction["edited"] = [[x / 2, y] for x, y in prediction["edited"]]
    ranking = protocol.ranking.model_copy(update={"unranked_flags": unranked})
    protocol = protocol.model_copy(update={"ranking": ranking})
    report = check(encoded(planning), protocol=protocol, manifest=manifest).report
    why = "source and edited are alike in 100% of the pairs: it reacts to no hazard"
    assert report.notes == ((f"it will be flagged Blind to the edit: {why}",) if noted else ())
    wanted = f"flagged Blind to the edit: {why}" if refused else None
    assert report.unranked_because == wanted


def test_a_sound_strategy_file_gives_its_answers(
    strategy: dict[str, Any], protocol: ProtocolDocument, manifest: Manifest, encoded: Encode
) -> None:
    strategy["predictions"][0]["strategy"] = None
    strategy["predictions"][1]["reminder"] = {
        "hazard_present": True,
        "hazard_type": "SE1",
        "risk_level": "high",
        "evidence": "a person\nbehind the van",
        "recommended_strategy": "D",
    }
    checked = check(encoded(strategy), protocol=protocol, manifest=manifest)
    assert checked.report.faults == ()
    assert isinstance(checked.document, StrategyDocument)
    answers = checked.document.answers
    assert answers["s-001"].strategy is None
    assert answers["s-003"].strategy == "C"
    reminder = answers["s-002"].reminder
    assert reminder is not None
    assert reminder.recommended_strategy == "D"
    assert checked.report.notes == (
        "strategy is null for 1 of 3 samples: each counts as wrong and under-warning",
    )


def test_gzip_is_recognised_by_its_first_bytes(
    planning: dict[str, Any], protocol: ProtocolDocument, manifest: Manifest, encoded: Encode
) -> None:
    data = gzip.compress(encoded(planning))
    report = check(data, protocol=protocol, manifest=manifest).report
    assert report.is_valid
    assert report.size_bytes == len(data)


def test_keys_may_stand_in_any_order(
    planning: dict[str, Any], protocol: ProtocolDocument, manifest: Manifest, encoded: Encode
) -> None:
    turned = dict(reversed(planning.items()))
    checked = check(encoded(turned), protocol=protocol, manifest=manifest)
    assert checked.report.is_valid
    assert isinstance(checked.document, PlanningDocument)


def test_the_schema_may_follow_the_predictions_of_a_strategy_file(
    strategy: dict[str, Any], faults: Callable[[Any], Any]
) -> None:
    del strategy["predictions"][0]["strategy"]
    group = faults(dict(reversed(strategy.items())))[FaultCode.MISSING_KEY]
    assert [example.expected for example in group.examples] == ['the key "strategy"']


def test_a_file_of_the_other_challenge_is_refused(
    strategy: dict[str, Any], protocol: ProtocolDocument, encoded: Encode
) -> None:
    report = check(encoded(strategy), protocol=protocol, challenge=PLANNING.id).report
    assert [group.code for group in report.faults] == [FaultCode.WRONG_SCHEMA]
    assert report.faults[0].examples[0].hint == (
        "this is a strategy file, and a planning file is wanted"
    )


@pytest.mark.parametrize(("given", "wanted"), [("strategy", "planning"), ("planning", "strategy")])
def test_the_manifest_of_a_phase_says_which_challenge_its_files_are_for(
    given: str, wanted: str, manifest: Manifest, protocol: ProtocolDocument, request: Any
) -> None:
    """Without a server, and whatever else the caller would take."""
    data = json.dumps(request.getfixturevalue(given)).encode()
    of_phase = manifest.model_copy(update={"challenge": wanted})
    assert check(data, protocol=protocol, manifest=manifest).report.is_valid
    for asked in (None, ChallengeId(given)):
        report = check(data, protocol=protocol, manifest=of_phase, challenge=asked).report
        hints = [each.hint for group in report.faults for each in group.examples]
        assert hints == [f"this is a {given} file, and a {wanted} file is wanted"]


def test_all_faults_are_found_in_one_pass(
    planning: dict[str, Any], faults: Callable[[Any], Any]
) -> None:
    first, second, third = copy.deepcopy(planning["predictions"])
    first["sample_id"] = "s-01"
    first["edited"][2][0] = float("nan")
    second["source"] = second["source"][:5]
    third["edited"][0] = [31.0, 0.0]
    third["colour"] = "red"
    planning |= {"split": "other", "predictions": [first, second, third, third], "team": "us"}
    found = faults(planning)
    assert {code: group.count for code, group in found.items()} == {
        FaultCode.UNKNOWN_KEY: 3,
        FaultCode.WRONG_SPLIT: 1,
        FaultCode.UNKNOWN_SAMPLE: 1,
        FaultCode.MISSING_SAMPLE: 1,
        FaultCode.DUPLICATE_SAMPLE: 1,
        FaultCode.WRONG_WAYPOINT_COUNT: 1,
        FaultCode.NON_FINITE: 1,
        FaultCode.STEP_TOO_LONG: 2,
    }
    assert found[FaultCode.NON_FINITE].examples[0].path == "$.predictions[0].edited[2][0]"
    assert found[FaultCode.UNKNOWN_SAMPLE].examples[0].hint == 'did you mean "s-001"?'
    assert found[FaultCode.STEP_TOO_LONG].examples[0].sample_id == "s-003"
