from collections.abc import Callable
from pathlib import Path

import pytest
from tests.support.full_disk import room_for

from exceptiondrive import InvalidArgumentError, Recorder, StrategyRecorder, check_file
from exceptiondrive.checking import manifest_of, write_file
from exceptiondrive.cli.output import save_new
from exceptiondrive.inputs import given_split
from exceptiondrive_schemas.protocol import packaged_protocol
from exceptiondrive_schemas.split import Manifest

MakeFile = Callable[..., Path]


@pytest.fixture
def manifest(split_file: Path) -> Manifest:
    return manifest_of(given_split(split_file), packaged_protocol())


def test_a_sound_file_has_no_faults(planning_file: MakeFile, manifest: Manifest) -> None:
    report = check_file(planning_file(), manifest=manifest)
    assert report.is_valid
    assert (report.challenge, report.split, report.n_predictions) == ("planning", "tiny", 4)


def test_all_faults_are_listed_at_once(planning_file: MakeFile, manifest: Manifest) -> None:
    path = planning_file(
        predictions=[
            {"sample_id": "s0", "source": None, "edited": [[0.0, 0.0]] * 5},
            {"sample_id": "s9", "source": None, "edited": None},
        ]
    )
    codes = {group.code.value: group.count for group in check_file(path, manifest=manifest).faults}
    assert codes == {"wrong_waypoint_count": 1, "unknown_sample": 1, "missing_sample": 3}


def test_without_a_manifest_only_the_form_is_checked(planning_file: MakeFile) -> None:
    assert check_file(planning_file(split="another")).is_valid
    assert not check_file(planning_file(schema="exceptiondrive.planning/9")).is_valid


def test_a_full_disk_keeps_no_half_of_a_file(tmp_path: Path) -> None:
    kept, new = tmp_path / "kept.json", tmp_path / "new.json"
    kept.write_text("{}")
    with room_for(20):
        with pytest.raises(InvalidArgumentError, match=r"kept\.json cannot be written"):
            write_file(kept, b"x" * 1_000)
        with pytest.raises(InvalidArgumentError, match=r"new\.json cannot be written"):
            save_new(new, b"x" * 1_000)
    assert kept.read_text() == "{}"
    assert sorted(tmp_path.iterdir()) == [kept]


def test_a_file_that_is_not_there_is_said(tmp_path: Path) -> None:
    with pytest.raises(InvalidArgumentError, match=r"none\.json cannot be read: No such file"):
        check_file(tmp_path / "none.json")


def test_what_the_recorder_writes_is_sound(tmp_path: Path, manifest: Manifest) -> None:
    with Recorder(tmp_path / "p.json.gz", split="tiny") as recorder:
        for sample_id in manifest.sample_ids:
            recorder.add(sample_id, source=[(2.5 * t, 0) for t in range(1, 7)], edited=None)
    report = check_file(tmp_path / "p.json.gz", manifest=manifest)
    assert report.is_valid, report.faults


def test_what_the_strategy_recorder_writes_is_sound(tmp_path: Path, manifest: Manifest) -> None:
    with StrategyRecorder(tmp_path / "a.json", split="tiny") as recorder:
        for sample_id in manifest.sample_ids:
            recorder.add(
                sample_id,
                strategy="C",
                reminder={
                    "hazard_present": True,
                    "hazard_type": "LB1",
                    "relative_location": "ahead",
                    "risk_level": "high",
                    "evidence": "a van stands in the lane",
                    "safety_constraint": "do not pass",
                    "recommended_strategy": "C",
                },
            )
    report = check_file(tmp_path / "a.json", manifest=manifest)
    assert report.is_valid, report.faults
    assert report.challenge == "strategy"
