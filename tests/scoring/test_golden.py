"""The reference scores, to 1e-9: those that came with the protocol, and those of plain loops."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from statistics import fmean
from typing import Any

import pytest
from tests.support import extract, naive_scorer, reference

from exceptiondrive.evaluation import score
from exceptiondrive_schemas.check import check
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.split import Manifest, Split
from exceptiondrive_scoring.arrays import SplitArrays, TrajectoryPairs
from exceptiondrive_scoring.grade import grade
from exceptiondrive_scoring.measure import measure
from exceptiondrive_scoring.sheet import Breakdown, MetricValues, aggregate


def _sheet(pairs: TrajectoryPairs, split: SplitArrays, protocol: ProtocolDocument) -> Breakdown:
    measurements = measure(pairs, split.regions_m, protocol.geometry, split.recorded_m)
    return aggregate(grade(measurements, split, protocol), split, protocol.taxonomy)


def _rows(sizes: dict[str, int], rows: dict[str, MetricValues]) -> dict[str, Any]:
    return {key: {"n": sizes[key], **row} for key, row in rows.items()}


@pytest.mark.parametrize("name", reference.NAMES)
def test_planners_files_get_the_reference_scores(
    name: str, tmp_path: Path, read_case: Callable[..., Any], protocol: ProtocolDocument
) -> None:
    case = reference.reference(name, tmp_path)
    pairs, split = read_case(case.split, case.file)
    if case.recorded is not None:
        split = replace(split, recorded_m=read_case(case.split, case.recorded)[0].source)
    sheet = _sheet(pairs, split, protocol)
    parts = {
        "families": _rows(sheet.family_sizes, sheet.families),
        "tasks": _rows(sheet.task_sizes, sheet.tasks),
    }
    case.check({"n": sheet.n, "micro": sheet.micro, "macro_family": sheet.macro_family, **parts})


@pytest.mark.parametrize("name", ["extract.wild", "carla-pairs.cosmos"])
def test_scoring_again_gives_the_same_bits(
    name: str, tmp_path: Path, read_case: Callable[..., Any], protocol: ProtocolDocument
) -> None:
    case = reference.reference(name, tmp_path)
    (one, split), (other, again) = (read_case(case.split, case.file) for _ in range(2))
    first, second = _sheet(one, split, protocol), _sheet(other, again, protocol)
    assert first == second


SPLIT = {"recorded": range(0, 160, 2), "control": range(7, 160, 11), "withdrawn": range(3, 160, 29)}


@pytest.fixture(scope="module")
def marked() -> tuple[Split, dict[str, bytes]]:
    """The made extract with recorded paths, controls and withdrawn samples, and its files."""
    made = extract.make_extract()
    document = json.loads(json.dumps(made.split))
    for number, sample in enumerate(document["samples"]):
        if number in SPLIT["recorded"]:
            sample["recorded"] = made.recorded[sample["sample_id"]]
        if number in SPLIT["control"]:
            sample["control"] = True
        if number in SPLIT["withdrawn"]:
            sample["withdrawn"] = "its picture shows another place"
    return Split.model_validate_json(json.dumps(document)), made.files


@pytest.mark.parametrize("planner", list(extract.PLANNERS))
def test_controls_and_withdrawn_samples_count_in_nothing(
    planner: str, marked: tuple[Split, dict[str, bytes]], protocol: ProtocolDocument
) -> None:
    split, files = marked
    document = check(
        files[planner], protocol=protocol, manifest=Manifest.of(split, protocol.geometry)
    ).document
    assert document is not None
    sheet = json.loads(score(document, split, protocol).model_dump_json())
    told = split.model_dump_json(by_alias=True, exclude_none=True)
    naive = naive_scorer.score(files[planner], json.loads(told))
    assert naive["n"] == len(split.counted) < len(split.samples)
    assert naive["micro"]["source_l2_m"] is not None
    assert "over_caution" in naive["micro"]
    reference.Reference(Path(), Path(), naive).check(sheet)
    assert sheet["micro"]["over_caution"] == naive["micro"]["over_caution"]
    assert sheet["coverage"]["n_edited"] == round(naive["coverage"]["edited"] * naive["n"])
    assert sheet["clearance_curve"] == _curve(files[planner], split, protocol)


def _curve(file: bytes, split: Split, protocol: ProtocolDocument) -> dict[str, Any]:
    """Count samples by plain loops, from the clearances of the naive scorer."""
    tasks = {task.id: task for task in protocol.tasks}
    answers = {each["sample_id"]: each for each in naive_scorer.read(file)["predictions"]}
    kept: dict[str, list[float]] = {}
    for sample in split.counted:
        clear_m = naive_scorer.clearance_m(answers[sample.sample_id], sample.region)
        task = tasks[sample.task]
        kept.setdefault(task.family, []).append(
            -1.0 if clear_m is None else clear_m / (sample.d_safe_m or task.d_safe_m)
        )

    def shares(values: list[float]) -> list[float]:
        return [fmean(value >= 0.1 * k for value in values) for k in range(21)]

    by_family = [shares(values) for values in kept.values()]
    return {
        "step": 0.1,
        "micro": pytest.approx(shares([value for values in kept.values() for value in values])),
        "macro_family": pytest.approx([fmean(column) for column in zip(*by_family, strict=True)]),
    }
