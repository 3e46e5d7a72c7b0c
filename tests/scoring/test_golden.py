"""The reference scores, to 1e-9: those that came with the protocol, and those of plain loops."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tests.support import reference

from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_scoring.arrays import SplitArrays, TrajectoryPairs
from exceptiondrive_scoring.grade import grade
from exceptiondrive_scoring.measure import measure
from exceptiondrive_scoring.sheet import Breakdown, Row, aggregate


def _sheet(pairs: TrajectoryPairs, split: SplitArrays, protocol: ProtocolDocument) -> Breakdown:
    measurements = measure(pairs, split.regions_m, protocol.geometry)
    return aggregate(grade(measurements, split, protocol), split, protocol.taxonomy)


def _rows(rows: dict[str, Row]) -> dict[str, Any]:
    return {key: {"n": row.n, **row.metrics} for key, row in rows.items()}


@pytest.mark.parametrize("name", reference.NAMES)
def test_planners_files_get_the_reference_scores(
    name: str, tmp_path: Path, read_case: Callable[..., Any], protocol: ProtocolDocument
) -> None:
    case = reference.reference(name, tmp_path)
    pairs, split = read_case(case.split, case.file)
    sheet = _sheet(pairs, split, protocol)
    parts = {"families": _rows(sheet.families), "tasks": _rows(sheet.tasks)}
    case.check({"n": sheet.n, "micro": sheet.micro, "macro_family": sheet.macro_family, **parts})


@pytest.mark.parametrize("name", ["extract.wild", "carla-pairs.cosmos"])
def test_scoring_again_gives_the_same_bits(
    name: str, tmp_path: Path, read_case: Callable[..., Any], protocol: ProtocolDocument
) -> None:
    case = reference.reference(name, tmp_path)
    (one, split), (other, again) = (read_case(case.split, case.file) for _ in range(2))
    first, second = _sheet(one, split, protocol), _sheet(other, again, protocol)
    assert first == second
