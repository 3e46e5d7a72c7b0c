"""What the client says of source fit is what the worker's sheet says, to the printed digits."""

import json
from pathlib import Path

import pytest
from tests.support import realdata
from tests.support.extract import make_extract

from exceptiondrive.evaluation import score, sound_file
from exceptiondrive_schemas.file_profile import FileProfile
from exceptiondrive_schemas.protocol import packaged_protocol
from exceptiondrive_schemas.score_sheet import ScoreSheet
from exceptiondrive_schemas.split import Split

METRICS = ("source_l2_m", "source_l2_1s_m", "source_l2_2s_m", "source_l2_3s_m")


def judged(file: Path, split: Split) -> tuple[FileProfile, ScoreSheet]:
    sound = sound_file(file, split, packaged_protocol("1.1"))
    assert sound.report.profile is not None
    return sound.report.profile, score(sound.document, sound.split, sound.protocol)


def assert_alike(profile: FileProfile, sheet: ScoreSheet) -> None:
    for key in METRICS:
        told, scored = getattr(profile, key), sheet.micro[key]
        assert scored is not None
        assert f"{told:.2f}" == f"{scored:.2f}", key
        assert told == pytest.approx(scored, rel=1e-9)


@pytest.mark.parametrize("planner", ["braking", "forgetful", "wild"])
def test_the_made_extract_is_told_as_it_is_scored(planner: str, tmp_path: Path) -> None:
    extract = make_extract()
    extract.write(tmp_path)
    samples = [
        {
            **sample,
            "recorded": [[x * 1.1, y + 0.2] for x, y in extract.recorded[sample["sample_id"]]],
        }
        for sample in extract.split["samples"]
    ]
    split = Split.model_validate_json(json.dumps({**extract.split, "samples": samples}))
    assert_alike(*judged(extract.path(tmp_path, planner), split))


@pytest.mark.parametrize("planner", ["gpt-4.1", "claude-3.7-sonnet"])
def test_a_real_planner_is_told_as_it_is_scored(planner: str) -> None:
    realdata.require()
    name = "nuscenes-real"
    recorded = realdata.file_path(name, "recorded-human")
    document = realdata.split_document(realdata.split_path(name), recorded)
    split = Split.model_validate_json(document)
    profile, sheet = judged(realdata.file_path("nuscenes-real", planner), split)
    assert_alike(profile, sheet)
    assert profile.mend is None
