import json
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.support import realdata, reference

from exceptiondrive import InvalidArgumentError, InvalidFileError, StrategyRecorder, evaluate_file
from exceptiondrive.inputs import given_split
from exceptiondrive_schemas.protocol import NEWEST, packaged_protocol
from exceptiondrive_schemas.score_sheet import ScoreSheet
from exceptiondrive_schemas.split import Split

MakeFile = Callable[..., Path]
STANDING = [[0.0, 0.0]] * 6


def test_driving_into_the_region_is_an_intrusion_of_every_sample(
    planning_file: MakeFile, split_file: Path
) -> None:
    sheet = evaluate_file(planning_file(), split=split_file)
    assert sheet.n == 4
    assert (sheet.micro["ur"], sheet.micro["hcc"], sheet.micro["cts"]) == (1.0, 0.0, 0.0)
    assert sheet.families["lane_blockage"].n == 1
    assert [flag.code for flag in sheet.plausibility.flags] == ["blind_to_the_edit"]


def test_a_sheet_names_protocol_and_split_by_digest(
    planning_file: MakeFile, split_file: Path
) -> None:
    sheet = evaluate_file(planning_file(), split=split_file)
    assert sheet.protocol.digest == packaged_protocol(NEWEST).digest
    assert sheet.split.revision == given_split(split_file).revision


def test_standing_still_keeps_the_clearance_by_hand(
    planning_file: MakeFile, split_file: Path
) -> None:
    """The front of the footprint is at 1.486 + 4.084 / 2 = 3.528 m; the region begins at 20 m."""
    path = planning_file(
        predictions=[
            {"sample_id": f"s{n}", "source": STANDING, "edited": STANDING} for n in range(4)
        ]
    )
    sheet = evaluate_file(path, split=split_file)
    clearance_m = 20.0 - 3.528
    of_stalled_vehicle = sheet.tasks["LB1"].metrics
    assert of_stalled_vehicle["hcc"] == 1.0
    assert of_stalled_vehicle["hpr"] == pytest.approx(1.0 / (clearance_m - 1.0 + 1.0), abs=1e-12)


def test_strategies_are_scored_too(tmp_path: Path, split_file: Path) -> None:
    """SE1 takes C or D, the others take C among others: three right, one missing."""
    with StrategyRecorder(tmp_path / "a.json", split="tiny") as recorder:
        for number in range(3):
            recorder.add(f"s{number}", strategy="C", reminder={"hazard_present": True})
        recorder.add("s3", strategy=None)
    sheet = evaluate_file(tmp_path / "a.json", split=split_file)
    assert sheet.challenge == "strategy"
    assert sheet.micro["accuracy"] == 0.75
    assert sheet.micro["missing"] == sheet.micro["under_warning"] == 0.25
    assert sheet.extra["reminder"]


def test_a_file_with_faults_is_refused_with_its_report(
    planning_file: MakeFile, split_file: Path
) -> None:
    with pytest.raises(InvalidFileError) as caught:
        evaluate_file(planning_file(split="other"), split=split_file)
    assert [group.code for group in caught.value.report.faults] == ["wrong_split"]


@pytest.mark.parametrize("text", ["{}", "[]", "rubbish", '{"schema": "exceptiondrive.split/1"}'])
def test_a_file_that_is_no_split_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "split.json"
    path.write_text(text)
    with pytest.raises(InvalidArgumentError, match="is not a split file") as caught:
        given_split(path)
    assert "split download" in caught.value.advice


def test_a_split_with_tasks_that_the_protocol_does_not_list_is_refused(
    planning_file: MakeFile, split_file: Path
) -> None:
    document = json.loads(split_file.read_text())
    document["samples"][0]["task"] = "ZZ9"
    split_file.write_text(json.dumps(document))
    with pytest.raises(InvalidArgumentError, match="ZZ9"):
        evaluate_file(planning_file(), split=split_file)


def test_a_split_with_a_sample_twice_is_refused(planning_file: MakeFile, split_file: Path) -> None:
    """Workers refuse it, too: it would count as two."""
    document = json.loads(split_file.read_text())
    document["samples"].append({**document["samples"][1], "withdrawn": "moved"})
    with pytest.raises(InvalidArgumentError, match="more than once: s1"):
        evaluate_file(planning_file(), split=document)


def test_a_split_in_which_no_sample_counts_is_refused(
    planning_file: MakeFile, split_file: Path
) -> None:
    document = json.loads(split_file.read_text())
    for sample in document["samples"]:
        sample["withdrawn"] = "the edit is not to be seen"
    split = Split.model_validate_json(json.dumps(document))
    with pytest.raises(InvalidArgumentError, match="no sample counts"):
        evaluate_file(planning_file(), split=split)


@pytest.mark.parametrize(
    ("region", "fault"),
    [
        ([[5.0, 2.0]] * 4, "smaller than 0.01 m2"),
        ([[5.0, 2.0], [6.0, 2.0], [7.0, 2.0], [8.0, 2.0]], "that cross or touch themselves"),
        ([[90.0, 60.0], [91.0, 60.0], [91.0, 61.0], [90.0, 61.0]], "more than 100 m away"),
        ([[1e308, 1e308], [1e308, 2.0], [5.0, 2.0], [5.0, 1e308]], "more than 100 m away"),
        ([[8.0, 2.0], [9.0, 3.0], [9.0, 2.0], [8.0, 3.0]], "that cross or touch themselves"),
        ([[8.0, 2.0], [10.0, 2.0], [9.0, 2.0], [9.0, 3.0]], "that cross or touch themselves"),
        ([[3.0, 0.0], [9.0, 0.0], [9.0, 2.0], [3.0, 2.0]], "that touch the footprint at t = 0"),
        ([[-20, -20], [20, -20], [20, 20], [-20, 20]], "that touch the footprint at t = 0"),
    ],
    ids=[
        "a point",
        "a line",
        "far",
        "farther than numbers go",
        "a bow",
        "a spike",
        "at the car",
        "around the car",
    ],
)
def test_a_split_with_a_region_that_no_server_takes_is_refused(
    planning_file: MakeFile, split_file: Path, region: list[list[float]], fault: str
) -> None:
    document = json.loads(split_file.read_text())
    for sample in document["samples"][1::2]:
        sample["region"] = region
    split_file.write_text(json.dumps(document))
    named = sorted(sample["sample_id"] for sample in document["samples"][1::2])
    with pytest.raises(InvalidArgumentError) as caught:
        evaluate_file(planning_file(), split=split_file)
    assert f"{fault} ({len(named)}): {named[0]}, " in str(caught.value)


@pytest.mark.parametrize("name", reference.NAMES)
def test_reference_scores_are_reproduced_to_1e_9(name: str, tmp_path: Path) -> None:
    case = reference.reference(name, tmp_path)
    split = Split.model_validate_json(realdata.split_document(case.split, case.recorded))
    case.check(evaluate_file(case.file, split=split).model_dump(mode="json"))


def test_evaluating_twice_gives_the_same_bits(planning_file: MakeFile, split_file: Path) -> None:
    first, second = (evaluate_file(planning_file(), split=split_file) for _ in range(2))
    assert isinstance(first, ScoreSheet)
    assert first.model_dump_json() == second.model_dump_json()


def test_client_and_worker_give_the_same_sheet(planning_file: MakeFile, split_file: Path) -> None:
    pytest.importorskip("exceptiondrive_worker", reason="the client by itself")
    from exceptiondrive_schemas.challenges import PLANNING
    from exceptiondrive_scoring.challenge import exact_sheet, scoring_of
    from exceptiondrive_worker.splits.store import load_split
    from exceptiondrive_worker.upload_reader import read_upload

    protocol = packaged_protocol(NEWEST)
    swerving = [[4.0 * step, 0.3 * step] for step in range(1, 7)]
    path = planning_file(
        predictions=[
            {"sample_id": "s2", "source": swerving, "edited": STANDING},
            {"sample_id": "s0", "source": None, "edited": swerving},
            {"sample_id": "s3", "source": STANDING, "edited": None},
            {"sample_id": "s1", "source": swerving, "edited": swerving},
        ]
    )
    loaded = load_split(given_split(split_file), protocol)
    answers = read_upload(
        path.read_bytes(), challenge=PLANNING, manifest=loaded.manifest, protocol=protocol
    )
    assert isinstance(answers, dict)
    scoring = scoring_of(PLANNING.id)
    measured = scoring.measure(answers, loaded.arrays, protocol.geometry)
    ref = loaded.manifest.ref
    sheet = exact_sheet(scoring, measured, loaded.arrays, ref, protocol)
    assert sheet == evaluate_file(path, split=split_file)
