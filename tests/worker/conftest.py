import json
from typing import Any

import pytest

from exceptiondrive_schemas.protocol import Protocol, packaged_protocol
from exceptiondrive_schemas.split import Split

AHEAD = ((10.0, -1.0), (12.0, -1.0), (12.0, 1.0), (10.0, 1.0))


@pytest.fixture(scope="session")
def protocol() -> Protocol:
    return packaged_protocol()


@pytest.fixture(scope="session")
def make_split() -> Any:
    """Make a split of samples given as `{sample_id: changes}`; regions lie ahead by default."""

    def make(samples: dict[str, dict[str, Any]], name: str = "tiny") -> Split:
        usual = {"scene_id": "scene-1", "task": "SE1", "region": AHEAD}
        document = {
            "schema": "exceptiondrive.split/1",
            "name": name,
            "title": "A tiny split",
            "samples": [
                {"sample_id": sample_id, **usual, **changes}
                for sample_id, changes in samples.items()
            ],
        }
        return Split.model_validate_json(json.dumps(document))

    return make
