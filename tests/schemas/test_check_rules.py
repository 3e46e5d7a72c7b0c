"""Rules for single predictions: what is refused, where, and with which words."""

import json
from collections.abc import Callable
from typing import Any

import pytest

from exceptiondrive_schemas.challenges import STRATEGY
from exceptiondrive_schemas.check import check
from exceptiondrive_schemas.check.fault_list import json_path, shown
from exceptiondrive_schemas.check.sample_ids import SHARDS, NearestId
from exceptiondrive_schemas.check.trajectory_forms import point_in
from exceptiondrive_schemas.faults import MAX_EXAMPLES, CheckReport, Fault, FaultCode
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.split import Manifest

Check = Callable[[Any], CheckReport]


@pytest.fixture
def checked(protocol: ProtocolDocument, manifest: Manifest) -> Check:
    return lambda document: (
        check(json.dumps(document).encode(), protocol=protocol, manifest=manifest).report
    )


def only_fault(report: CheckReport) -> tuple[FaultCode, Fault]:
    (group,) = report.faults
    assert group.count == len(group.examples) == 1
    return group.code, group.examples[0]


@pytest.mark.parametrize(
    ("trajectory", "code", "path", "got"),
    [
        ("stop", FaultCode.WRONG_TYPE, "", "text"),
        (7, FaultCode.WRONG_TYPE, "", "a number"),
        (True, FaultCode.WRONG_TYPE, "", "a boolean"),
        ({}, FaultCode.WRONG_TYPE, "", "an object with 0 keys"),
        ([], FaultCode.WRONG_WAYPOINT_COUNT, "", "0 waypoints"),
        ([[0, 0]] * 5, FaultCode.WRONG_WAYPOINT_COUNT, "", "5 waypoints"),
        ([[1, 0]] * 7, FaultCode.WRONG_WAYPOINT_COUNT, "", "7 waypoints"),
        ([0.0] * 12, FaultCode.WRONG_WAYPOINT_SHAPE, "", "one flat list of 12 numbers"),
        ([[0, 0]] * 5 + [[0]], FaultCode.WRONG_WAYPOINT_SHAPE, "[5]", "a list of 1 value"),
        ([[0, 0]] * 5 + [None], FaultCode.WRONG_WAYPOINT_SHAPE, "[5]", "null"),
        ([[0, 0]] * 5 + [[0, True]], FaultCode.WRONG_TYPE, "[5][1]", "true"),
        ([[0, 0]] * 5 + [[0, "1"]], FaultCode.WRONG_TYPE, "[5][1]", '"1"'),
        ([[0, 0]] * 5 + [[0, None]], FaultCode.WRONG_TYPE, "[5][1]", "null"),
        ([[0, 0]] * 5 + [[0, -200.5]], FaultCode.OUT_OF_BOUNDS, "[5][1]", "-200.5"),
        ([[0, 0]] * 5 + [[0, 10**400]], FaultCode.NON_FINITE, "[5][1]", "Infinity, or a number"),
        ([[0, 0]] * 5 + [[0, 31]], FaultCode.STEP_TOO_LONG, "[5]", "31.00 m"),
        ([[30.5, 0]] * 6, FaultCode.STEP_TOO_LONG, "[0]", "30.50 m"),
    ],
)
def test_a_wrong_trajectory_is_refused(
    trajectory: Any, code: FaultCode, path: str, got: str, planning: dict[str, Any], checked: Check
) -> None:
    planning["predictions"][1]["edited"] = trajectory
    found, fault = only_fault(checked(planning))
    assert found == code
    assert fault.path == f"$.predictions[1].edited{path}"
    assert fault.sample_id == "s-002"
    assert fault.got.startswith(got)


def test_what_is_on_the_bound_passes(planning: dict[str, Any], checked: Check) -> None:
    planning["predictions"][0]["edited"] = [[30.0 * t, 0] for t in range(1, 7)]
    planning["predictions"][1]["edited"] = [[33 + 30 * t, 20] for t in range(-1, 5)]
    assert checked(planning).is_valid


@pytest.mark.parametrize("prediction", [None, 1, "x", [], [{}]])
def test_a_prediction_is_an_object(
    prediction: Any, planning: dict[str, Any], checked: Check
) -> None:
    planning["predictions"].append(prediction)
    code, fault = only_fault(checked(planning))
    assert (code, fault.path) == (FaultCode.WRONG_TYPE, "$.predictions[3]")


@pytest.mark.parametrize("sample_id", [None, 7, "", ["s-001"]])
def test_a_sample_id_is_a_text(sample_id: Any, planning: dict[str, Any], checked: Check) -> None:
    planning["predictions"][0]["sample_id"] = sample_id
    codes = [group.code for group in checked(planning).faults]
    assert codes == [FaultCode.WRONG_TYPE, FaultCode.MISSING_SAMPLE]


def test_predictions_by_sample_id_are_explained(planning: dict[str, Any], checked: Check) -> None:
    planning["predictions"] = {each["sample_id"]: each for each in planning["predictions"]}
    code, fault = only_fault(checked(planning))
    assert (code, fault.path) == (FaultCode.WRONG_TYPE, "$.predictions")
    assert fault.hint == (
        "write a list; the sample id stands inside each prediction: "
        "`exceptiondrive convert FILE` does"
    )


@pytest.mark.parametrize("key", ["schema", "split", "predictions"])
def test_a_missing_outer_key_is_named(key: str, planning: dict[str, Any], checked: Check) -> None:
    del planning[key]
    code, fault = only_fault(checked(planning))
    assert (code, fault.expected) == (FaultCode.MISSING_KEY, f'the key "{key}"')


@pytest.mark.parametrize(
    ("key", "value", "code"),
    [
        ("strategy", "F", FaultCode.UNKNOWN_STRATEGY),
        ("strategy", "a", FaultCode.UNKNOWN_STRATEGY),
        ("strategy", 1, FaultCode.WRONG_TYPE),
        ("reminder", "stop", FaultCode.WRONG_TYPE),
        ("reminder", {"colour": "red"}, FaultCode.UNKNOWN_KEY),
        ("reminder", {"hazard_present": "yes"}, FaultCode.WRONG_TYPE),
        ("reminder", {"hazard_present": 1}, FaultCode.WRONG_TYPE),
        ("reminder", {"hazard_type": "XX1"}, FaultCode.UNKNOWN_HAZARD_TYPE),
        ("reminder", {"hazard_type": ["SE1"]}, FaultCode.WRONG_TYPE),
        ("reminder", {"risk_level": "extreme"}, FaultCode.UNKNOWN_RISK_LEVEL),
        ("reminder", {"recommended_strategy": "stop"}, FaultCode.UNKNOWN_STRATEGY),
        ("reminder", {"evidence": 5}, FaultCode.WRONG_TYPE),
        ("reminder", {"evidence": "x" * 2001}, FaultCode.TEXT_TOO_LONG),
        ("reminder", {"safety_constraint": "\x1b[31m"}, FaultCode.INVALID_TEXT),
        ("reminder", {"relative_location": "\ud800"}, FaultCode.INVALID_TEXT),
    ],
)
def test_a_wrong_answer_is_refused(
    key: str, value: Any, code: FaultCode, strategy: dict[str, Any], checked: Check
) -> None:
    strategy["predictions"][2][key] = value
    found, fault = only_fault(checked(strategy))
    assert found == code
    assert fault.path.startswith(f"$.predictions[2].{key}")
    assert fault.sample_id == "s-003"


def test_a_duplicate_key_is_found_wherever_it_stands(
    planning: dict[str, Any], protocol: ProtocolDocument
) -> None:
    planning["note"] = [{"deep": 0}]
    text = json.dumps(planning).replace('{"deep": 0}', '{"a": 0, "\\u0061": 1}')
    text = text.replace('"split"', '"split": "example", "split"', 1)
    report = check(text.encode(), protocol=protocol).report
    groups = {group.code: group for group in report.faults}
    paths = [example.path for example in groups[FaultCode.DUPLICATE_KEY].examples]
    assert paths == ["$", "$.note[0]"]


@pytest.mark.row("I07")
def test_examples_are_few_and_the_count_is_whole(planning: dict[str, Any], checked: Check) -> None:
    unknown = [{"sample_id": f"x-{n}", "source": None, "edited": None} for n in range(50)]
    planning["predictions"] += unknown
    (group,) = checked(planning).faults
    assert group.count == 50
    assert len(group.examples) == MAX_EXAMPLES
    assert group.examples[19].path == "$.predictions[22].sample_id"
    assert [example.sample_id for example in group.examples] == [f"x-{n}" for n in range(20)]


def test_a_missing_sample_names_the_id_that_stands_in_its_place(
    planning: dict[str, Any], checked: Check
) -> None:
    planning["predictions"][0]["sample_id"] = "S-001"
    groups = {group.code: group for group in checked(planning).faults}
    missing = groups[FaultCode.MISSING_SAMPLE].examples[0]
    assert missing.sample_id == "s-001"
    assert missing.hint == 'the file has "S-001", which is no sample'


def test_a_file_of_few_samples_is_asked_whether_it_is_a_shard(
    planning: dict[str, Any], checked: Check
) -> None:
    del planning["predictions"][1:]
    (missing,) = checked(planning).faults
    assert {fault.hint for fault in missing.examples} == {SHARDS}


def test_no_hint_leads_a_strategy_file_to_convert_which_reads_trajectories_alone(
    strategy: dict[str, Any],
    planning: dict[str, Any],
    protocol: ProtocolDocument,
    manifest: Manifest,
) -> None:
    sound = json.dumps(strategy)
    predictions = strategy["predictions"]
    by_id = {each["sample_id"]: {"strategy": "C"} for each in predictions}
    hints = {
        json.dumps(predictions): "looks like a bare list of predictions",
        "\n".join(map(json.dumps, predictions)): "looks like JSON lines",
        f"{sound}\n{sound}": "looks like several files in one",
        json.dumps(strategy | {"predictions": by_id}): "write a list; the sample id stands inside "
        "each prediction",
        f"\ufeff{sound}": None,
        json.dumps(strategy | {"predictions": predictions[:1]}): "one shard of several?",
        json.dumps({"results": predictions}): "write what is under it alone into the file",
    }
    for text, hint in hints.items():
        for challenge in (None, STRATEGY.id):
            told = check(text.encode(), protocol=protocol, manifest=manifest, challenge=challenge)
            found = [fault.hint for group in told.report.faults for fault in group.examples]
            assert set(found) == {hint}, text[:40]
    wide = check(sound.encode("utf-16"), protocol=protocol, challenge=STRATEGY.id).report
    assert wide.faults[0].examples[0].hint is None
    of_pairs = check(json.dumps(planning["predictions"]).encode(), protocol=protocol).report
    assert "`exceptiondrive convert FILE" in str(of_pairs.faults[0].examples[0].hint)


def test_an_empty_file_of_predictions_and_one_with_other_ids_are_no_shards(
    planning: dict[str, Any], checked: Check
) -> None:
    del planning["predictions"][1:]
    planning["predictions"].append({**planning["predictions"][0], "sample_id": "another"})
    groups = {group.code: group for group in checked(planning).faults}
    assert {fault.hint for fault in groups[FaultCode.MISSING_SAMPLE].examples} == {None}
    planning["predictions"] = []
    groups = {group.code: group for group in checked(planning).faults}
    assert {fault.hint for fault in groups[FaultCode.MISSING_SAMPLE].examples} == {None}


@pytest.mark.parametrize("wanted", ["scene-0041-004x", "cene-0041-0041", "Scene-0041-0041"])
def test_the_nearest_id_is_found_among_many(wanted: str) -> None:
    ids = NearestId(f"scene-{n:04}-{n % 97:04}" for n in range(50_000))
    assert ids.nearest(wanted) == "scene-0041-0041"
    assert ids.nearest("nothing like it") is None
    assert ids.nearest("s" * 10_000) is None


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (None, "null"),
        (True, "true"),
        (1.5, "1.5"),
        (float("nan"), "NaN"),
        (float("-inf"), "-Infinity, or a number too large to hold"),
        ([1], "a list of 1 value"),
        ({"a": 1, "b": 2}, "an object with 2 keys"),
        ("a\n\u202eb\x00", '"a\\u000a\\u202eb\\u0000"'),
        ("x" * 70, f'"{"x" * 60}..." (70 characters)'),
    ],
)
def test_a_value_is_shown_in_a_few_printable_words(value: Any, words: str) -> None:
    assert shown(value) == words


def test_a_path_quotes_keys_that_are_no_names() -> None:
    path = ("predictions", 3, "edited", 2, 0)
    assert json_path(path) == "$.predictions[3].edited[2][0]"
    assert json_path(("my key", 0)) == '$["my key"][0]'


def test_a_point_has_one_heading() -> None:
    assert point_in({"x": 1.0, "y": 2.0, "heading": 3.0, "yaw": 4.0}) == [1.0, 2.0, 3.0]
