"""Real planner files through the worker's own stages: the reference scores, to 1e-9."""

import json
from pathlib import Path

import pytest

from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_worker.private_store import PrivateStore
from exceptiondrive_worker.split_store import load_split, read_split
from exceptiondrive_worker.stages import Stages, Target
from exceptiondrive_worker.upload_reader import read_upload

ROOT = Path(__file__).parents[2]
REAL = ROOT.parent / "shared" / "realdata"
GOLDEN = ROOT / "tests" / "golden"


@pytest.mark.parametrize("name", ["nuscenes-real.gpt-4.1", "carla-pairs.cosmos"])
def test_the_exact_sheet_equals_the_reference(
    name: str, tmp_path: Path, protocol: ProtocolDocument
) -> None:
    folder, submission = name.split(".", 1)
    upload = REAL / folder / f"{submission}.json.gz"
    if not upload.exists():
        pytest.skip("the real planner files are not beside this repository")
    split = load_split(read_split(REAL / folder / "split.json.gz"), protocol)
    stages = Stages(
        PrivateStore(tmp_path / "private"),
        lambda digest: upload.read_bytes(),
        lambda data, challenge, manifest, protocol: read_upload(
            data, challenge=challenge, manifest=manifest, protocol=protocol
        ),
    )
    target = Target("sha256:real", PLANNING, split, protocol)
    sheet = stages.score(target).sheet
    expected = json.loads((GOLDEN / f"{name}.json").read_text())
    assert sheet.n == expected["n"]
    assert sheet.micro == pytest.approx(expected["micro"], abs=1e-9)
    assert sheet.macro_family == pytest.approx(expected["macro_family"], abs=1e-9)
    for rows, wanted in ((sheet.families, "families"), (sheet.tasks, "tasks")):
        assert rows.keys() == expected[wanted].keys()
        for key, row in rows.items():
            assert {"n": row.n, **row.metrics} == pytest.approx(expected[wanted][key], abs=1e-9)
    assert stages.score(target).sheet == sheet, "what comes back from the store is the same"
