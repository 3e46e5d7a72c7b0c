"""The split of a topology: as large as a real one, small, or with the canary in it; and what was driven there."""

import gzip
import json
from pathlib import Path

from tests.canary.values import CANARY_M


def _rewrite(path: Path, document: object) -> None:
    """Write another split; the datasheet beside it counted the one before."""
    path.write_bytes(gzip.compress(json.dumps(document).encode()))
    path.with_name("datasheet.json").unlink(missing_ok=True)


Drive = list[list[float]]


def drives_in(path: Path) -> dict[str, Drive]:
    """Return the recorded drive of each sample."""
    document = json.loads(gzip.decompress(path.read_bytes()))
    return {sample["sample_id"]: sample["recorded"] for sample in document["samples"]}


def multiply(path: Path, copies: int) -> None:
    """Make a split as large as a real one: every sample so many times, under other ids."""
    document = json.loads(gzip.decompress(path.read_bytes()))
    document["samples"] = [
        {**sample, "sample_id": f"{sample['sample_id']}-{copy}"}
        for copy in range(copies)
        for sample in document["samples"]
    ]
    _rewrite(path, document)


def thin(path: Path, every: int) -> None:
    """Keep one sample of so many: files for it are as much smaller."""
    document = json.loads(gzip.decompress(path.read_bytes()))
    _rewrite(path, {**document, "samples": document["samples"][::every]})


def plant_canary(path: Path) -> None:
    """Let one region reach to the canary, far behind all that clients drive."""
    document = json.loads(gzip.decompress(path.read_bytes()))
    far = [[10.0, -1.0], [CANARY_M, -1.0], [CANARY_M, 1.0], [10.0, 1.0]]
    document["samples"][0]["region"] = far
    _rewrite(path, document)
