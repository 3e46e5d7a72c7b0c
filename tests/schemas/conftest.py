from typing import Any

import pytest

from exceptiondrive_schemas.protocol import ProtocolDocument, packaged_protocol
from exceptiondrive_schemas.split import Manifest

STRAIGHT = [[1.5 * t, 0.0] for t in range(1, 7)]
SAMPLE_IDS = ("s-001", "s-002", "s-003")


@pytest.fixture(scope="session")
def protocol() -> ProtocolDocument:
    return packaged_protocol("1.0")


@pytest.fixture(scope="session")
def manifest() -> Manifest:
    return Manifest(
        schema_="exceptiondrive.manifest/1",
        name="example",
        title="Three samples",
        revision="sha256:" + "0" * 64,
        waypoints=6,
        time_step_s=0.5,
        sample_ids=SAMPLE_IDS,
    )


@pytest.fixture
def planning() -> dict[str, Any]:
    """A sound planning file as an object; tests break it."""
    predictions = [
        {
            "sample_id": sample_id,
            "source": [list(waypoint) for waypoint in STRAIGHT],
            "edited": [list(waypoint) for waypoint in STRAIGHT],
        }
        for sample_id in SAMPLE_IDS
    ]
    return {"schema": "exceptiondrive.planning/1", "split": "example", "predictions": predictions}


@pytest.fixture
def strategy() -> dict[str, Any]:
    """A sound strategy file as an object; tests break it."""
    return {
        "schema": "exceptiondrive.strategy/1",
        "split": "example",
        "predictions": [{"sample_id": sample_id, "strategy": "C"} for sample_id in SAMPLE_IDS],
    }
