"""Real planner files, and as many variations of them as wanted."""

import gzip
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

REALDATA = Path(__file__).parents[3] / "shared" / "realdata" / "carla-pairs"
SPLIT_FILE = REALDATA / "split.json.gz"


def variations() -> Iterator[bytes]:
    """Yield real planner files, then the same with every waypoint moved a little further."""
    documents = [
        json.loads(gzip.decompress(path.read_bytes()))
        for path in sorted(REALDATA.glob("*.json.gz"))
        if path != SPLIT_FILE
    ]
    number = 0
    while True:
        for document in documents:
            yield gzip.compress(_stretched(document, 1 + number / 1000), compresslevel=1)
        number += 1


def _stretched(document: dict[str, Any], factor: float) -> bytes:
    predictions = [
        {
            key: [[round(x * factor, 4), round(y * factor, 4)] for x, y in value]
            if isinstance(value, list)
            else value
            for key, value in prediction.items()
        }
        for prediction in document["predictions"]
    ]
    return json.dumps({**document, "predictions": predictions}).encode()
