"""What is published about the formats is generated, fresh, valid and consistent."""

import json
import re
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from exceptiondrive_schemas.api.submission import SubmissionView
from exceptiondrive_schemas.board import Board
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.check import MAX_INFLATED_BYTES, MAX_UPLOAD_BYTES, check
from exceptiondrive_schemas.check.json_stream import MAX_VALUE_CHARACTERS
from exceptiondrive_schemas.faults import CheckReport, FaultCode
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.publish.broken_files import BROKEN_FILES, report_of
from exceptiondrive_schemas.publish.examples import MODELS
from exceptiondrive_schemas.publish.written_files import written_files
from exceptiondrive_schemas.published import DOCUMENT_NAMES, example_text, schema_text
from exceptiondrive_schemas.score_sheet import ProtocolRef, ScoreSheet
from exceptiondrive_schemas.split import Manifest, Split
from exceptiondrive_schemas.submission_files import PlanningSubmission
from exceptiondrive_scoring.arrays import split_arrays
from exceptiondrive_scoring.challenge import document_columns, scoring_of
from exceptiondrive_scoring.sheet import aggregate

ROOT = Path(__file__).parents[2]
FILES = written_files()


@pytest.mark.parametrize("path", FILES)
def test_a_generated_file_is_fresh(path: str) -> None:
    written = (ROOT / path).read_text(encoding="utf-8")
    assert written == FILES[path], "run: python -m exceptiondrive_schemas.publish"


def test_no_other_file_lies_among_the_generated_ones() -> None:
    for folder in ("schemas", "examples"):
        found = (ROOT / "schemas/exceptiondrive_schemas/published" / folder).iterdir()
        assert {path.name for path in found} == {f"{name}.json" for name in DOCUMENT_NAMES}


@pytest.mark.parametrize("name", DOCUMENT_NAMES)
def test_an_example_is_valid_for_its_model_and_its_json_schema(name: str) -> None:
    MODELS[name].model_validate_json(example_text(name))
    schema = json.loads(schema_text(name))
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(json.loads(example_text(name)), schema)


@pytest.mark.parametrize("name", ["planning", "strategy", "split", "manifest"])
def test_a_json_schema_refuses_an_unknown_key(name: str) -> None:
    document = {**json.loads(example_text(name)), "colour": "red"}
    with pytest.raises(jsonschema.ValidationError, match="colour"):
        jsonschema.validate(document, json.loads(schema_text(name)))


@pytest.mark.parametrize("name", ["score-sheet", "board", "submission", "check-report", "problem"])
def test_a_json_schema_of_an_answer_lets_it_gain_fields(name: str) -> None:
    schema = json.loads(schema_text(name))
    assert '"additionalProperties": false' not in json.dumps(schema)
    jsonschema.validate({**json.loads(example_text(name)), "colour": "red"}, schema)


def test_the_examples_are_about_one_split(protocol: ProtocolDocument) -> None:
    split = Split.model_validate_json(example_text("split"))
    manifest = Manifest.model_validate_json(example_text("manifest"))
    assert manifest == Manifest.of(split, protocol.geometry)
    for name in ("planning", "strategy"):
        data = example_text(name).encode()
        assert check(data, protocol=protocol, manifest=manifest).report.is_valid
    assert ProtocolDocument.model_validate_json(example_text("protocol")) == protocol
    sheet = ScoreSheet.model_validate_json(example_text("score-sheet"))
    board = Board.model_validate_json(example_text("board"))
    of_split = {(it.split, it.protocol) for it in (sheet, board)}
    assert of_split == {(split.ref, ProtocolRef.of(protocol))}
    submission = SubmissionView.model_validate_json(example_text("submission"))
    assert submission.report is not None
    sent = PlanningSubmission.model_validate_json(example_text("planning"))
    data = sent.model_dump_json(by_alias=True, exclude_unset=True).encode()
    assert submission.report == check(data, protocol=protocol, manifest=manifest).report
    assert submission.file_digest == submission.report.digest
    assert (submission.sheet, submission.id) == (sheet, board.entries[0].submission_id)
    report = CheckReport.model_validate_json(example_text("check-report"))
    assert report == report_of(FaultCode.UNKNOWN_SAMPLE)


@pytest.mark.parametrize("entry", [0, 1])
def test_the_scores_of_the_examples_are_those_of_the_scoring_package(
    entry: int, protocol: ProtocolDocument
) -> None:
    split = Split.model_validate_json(example_text("split"))
    board = json.loads(example_text("board"))
    planning = json.loads(example_text("planning"))
    if board["entries"][entry]["method"] == "FREEZE":
        for prediction in planning["predictions"]:
            prediction["edited"] = [[0.0, 0.0]] * 6
    scored = scores_of(planning, split, protocol)
    shown = board["entries"][entry]
    assert {"hcc", "ur", "hpr", "cts", "cts_x", "cts_y"} == shown["micro"].keys()
    rows = {name: shown[name] for name in ("micro", "macro_family")} | shown["families"]
    if entry == 0:
        sheet = json.loads(example_text("score-sheet"))
        assert sheet["micro"] == shown["micro"]
        rows["lane_blockage"] |= sheet["tasks"]["LB1"]
    for name, row in rows.items():
        for key in shown["micro"]:
            assert row[key] == scored[name][key], (name, key)


def scores_of(planning: dict[str, Any], split: Split, protocol: ProtocolDocument) -> dict[str, Any]:
    document = check(json.dumps(planning).encode(), protocol=protocol).document
    assert document is not None
    arrays = split_arrays(split.samples, protocol.taxonomy)
    columns = document_columns(document, sorted(sample.sample_id for sample in split.samples))
    scoring = scoring_of(PLANNING.id)
    measured = scoring.measure(columns, arrays, protocol.geometry)
    found = aggregate(scoring.grade(measured, arrays, protocol), arrays, protocol.taxonomy)
    rows = {"micro": found.micro, "macro_family": found.macro_family}
    rows |= found.families
    return {
        name: {key: published(key, value) for key, value in row.items()}
        for name, row in rows.items()
    }


def published(key: str, value: float | None) -> float | None:
    decimals = 4 if PLANNING.metric(key).unit == "fraction" else 2
    return None if value is None else round(value, decimals)


def test_every_fault_code_has_a_broken_file() -> None:
    assert BROKEN_FILES.keys() == set(FaultCode)


@pytest.mark.parametrize("code", FaultCode)
def test_a_broken_file_has_its_fault_and_no_other(code: FaultCode) -> None:
    report = report_of(code)
    assert [group.code for group in report.faults] in (
        [code],
        [FaultCode.UNKNOWN_SAMPLE, FaultCode.MISSING_SAMPLE],  # one mistyped id is both
    )
    assert code in {group.code for group in report.faults}
    assert CheckReport.model_validate_json(report.model_dump_json()) == report


def test_the_page_on_the_format_shows_the_examples() -> None:
    page = (ROOT / "docs" / "submission-format.md").read_text(encoding="utf-8")
    shown = re.findall(r"<!-- example: (\w+) -->\n```json\n(.*?)```", page, flags=re.DOTALL)
    assert [name for name, _ in shown] == ["planning", "strategy"]
    for name, text in shown:
        assert text == example_text(name)


def test_the_page_on_the_format_names_the_limits_in_force(protocol: ProtocolDocument) -> None:
    page = (ROOT / "docs" / "submission-format.md").read_text(encoding="utf-8")
    geometry, rules = protocol.geometry, protocol.plausibility
    for words in (
        f"exactly {geometry.waypoints} waypoints",
        f"at most {geometry.max_coordinate_m:g} m either way",
        f"at most {geometry.max_step_m:g} m ({geometry.max_step_m / geometry.time_step_s:g} m/s)",
        f"move more than {rules.frame_check_min_motion_m:g} m",
        f"(at least {rules.frame_check_min_samples} of them)",
        f"above {rules.frame_check_max_angle_deg:g} degrees",
        f"at least {protocol.ranking.min_coverage:.0%}".replace("%", " %"),
        f"| file as uploaded | {MAX_UPLOAD_BYTES // 2**20} MiB |",
        f"| JSON after inflating | {MAX_INFLATED_BYTES // 2**20} MiB |",
        f"| one prediction | {MAX_VALUE_CHARACTERS:,} characters |",
    ):
        assert words in page
