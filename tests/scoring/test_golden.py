"""The reference scores that came with the protocol, to 1e-9."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_scoring.arrays import SplitArrays, TrajectoryPairs
from exceptiondrive_scoring.grade import grade
from exceptiondrive_scoring.measure import measure
from exceptiondrive_scoring.sheet import Breakdown, Row, aggregate

GOLDEN = Path(__file__).parents[1] / "golden"
RealCase = Callable[[str, str], tuple[TrajectoryPairs, SplitArrays]]


def _sheet(read: RealCase, protocol: ProtocolDocument, folder: str, submission: str) -> Breakdown:
    pairs, split = read(folder, submission)
    measurements = measure(pairs, split.regions_m, protocol.geometry)
    return aggregate(grade(measurements, split, protocol), split, protocol.taxonomy)


def _given(expected: dict[str, Any], found: dict[str, Any]) -> Any:
    """What a reference knows of a row: it may be older than a metric."""
    return pytest.approx({key: found.get(key) for key in expected}, abs=1e-9)


def _rows(expected: dict[str, Any], rows: dict[str, Row]) -> dict[str, Any]:
    return {
        key: _given(expected.get(key, {}), {"n": row.n, **row.metrics}) for key, row in rows.items()
    }


@pytest.mark.parametrize("name", ["nuscenes-real.gpt-4.1", "carla-pairs.cosmos"])
def test_real_planner_files_give_the_reference_scores(
    name: str, real_case: RealCase, protocol: ProtocolDocument
) -> None:
    expected = json.loads((GOLDEN / f"{name}.json").read_text())
    sheet = _sheet(real_case, protocol, *name.split(".", 1))
    assert sheet.n == expected["n"]
    assert expected["micro"] == _given(expected["micro"], sheet.micro)
    assert expected["macro_family"] == _given(expected["micro"], sheet.macro_family)
    assert expected["families"] == _rows(expected["families"], sheet.families)
    assert expected["tasks"] == _rows(expected["tasks"], sheet.tasks)


def test_scoring_again_gives_the_same_bits(real_case: RealCase, protocol: ProtocolDocument) -> None:
    first, second = (_sheet(real_case, protocol, "carla-pairs", "ppd") for _ in range(2))
    assert first == second
