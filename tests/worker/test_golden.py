"""Files of planners through the worker's own stages: the reference scores, to 1e-9."""

from pathlib import Path

import pytest
from tests.support import reference

from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_worker.private_store import PrivateStore
from exceptiondrive_worker.split_store import load_split, read_split
from exceptiondrive_worker.stages import Stages, Target
from exceptiondrive_worker.upload_reader import read_upload


@pytest.mark.parametrize("name", reference.NAMES)
def test_the_exact_sheet_equals_the_reference(
    name: str, tmp_path: Path, protocol: ProtocolDocument
) -> None:
    case = reference.reference(name, tmp_path)
    split = load_split(read_split(case.split), protocol)
    stages = Stages(
        PrivateStore(tmp_path / "private"),
        lambda digest: case.file.read_bytes(),
        lambda data, challenge, manifest, protocol: read_upload(
            data, challenge=challenge, manifest=manifest, protocol=protocol
        ),
    )
    target = Target("sha256:real", PLANNING, split, protocol)
    sheet = stages.score(target).sheet
    case.check(sheet.model_dump(mode="json"))
    assert stages.score(target).sheet == sheet, "what comes back from the store is the same"
