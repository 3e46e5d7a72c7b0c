"""Files of planners through the worker's own stages: the reference scores, to 1e-9."""

from pathlib import Path

import pytest
from tests.support import realdata, reference

from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.split import Split
from exceptiondrive_worker.splits.private_store import PrivateStore
from exceptiondrive_worker.splits.store import load_split
from exceptiondrive_worker.stages import Stages, Target
from exceptiondrive_worker.upload_reader import read_upload


@pytest.mark.parametrize("name", reference.NAMES)
def test_the_exact_sheet_equals_the_reference(
    name: str, tmp_path: Path, protocol: ProtocolDocument
) -> None:
    case = reference.reference(name, tmp_path)
    document = realdata.split_document(case.split, case.recorded)
    split = load_split(Split.model_validate_json(document), protocol)
    stages = Stages(
        PrivateStore(tmp_path / "private"),
        lambda digest: case.file.read_bytes(),
        read_upload,
    )
    target = Target("sha256:real", PLANNING, split, protocol)
    sheet = stages.score(target).sheet
    case.check(sheet.model_dump(mode="json"))
    assert stages.score(target).sheet == sheet, "what comes back from the store is the same"
