"""What must hold for any bytes at all: the readers of an upload agree, fast and place by place."""

import gzip
import json

from tests.support.two_readings import check_both_ways

from exceptiondrive_schemas.challenges import CHALLENGES, PLANNING, STRATEGY
from exceptiondrive_schemas.check import UnreadableFileError, inflate
from exceptiondrive_schemas.faults import CheckReport
from exceptiondrive_schemas.protocol import packaged_protocol
from exceptiondrive_schemas.published import DOCUMENT_NAMES, example_text
from exceptiondrive_schemas.split import Manifest
from exceptiondrive_scoring.challenge import document_columns
from exceptiondrive_worker.upload_reader import FAST_READERS, read_upload

PROTOCOL = packaged_protocol()
SMALL = ("s0", "s1")
MANIFEST = Manifest(
    schema_="exceptiondrive.manifest/1",
    name="tiny",
    title="Tiny",
    revision="sha256:0",
    waypoints=6,
    time_step_s=0.5,
    sample_ids=SMALL,
)
"""Two samples: a small input can be sound, so that changes of it reach deep."""


def assert_one_verdict(data: bytes, *, is_planning: bool) -> bool:
    """The fast reader accepts nothing that the checker refuses, and reads the same; say if sound.

    Raises:
        AssertionError: They differ.
    """
    challenge = CHALLENGES[PLANNING.id if is_planning else STRATEGY.id]
    read = read_upload(data, challenge=challenge, manifest=MANIFEST, protocol=PROTOCOL)
    checked = check_both_ways(data, protocol=PROTOCOL, manifest=MANIFEST, challenge=challenge.id)
    try:
        fast = FAST_READERS[challenge.id](inflate(data), MANIFEST, PROTOCOL)
    except UnreadableFileError:
        fast = None
    if checked.document is None:
        assert fast is None, "the fast reader took what the checker refuses"
        assert read == checked.report.to_keep()
        return False
    assert not isinstance(read, CheckReport)
    precise = document_columns(checked.document, MANIFEST.sample_ids)
    for columns in (read, fast or read):
        assert columns.keys() == precise.keys()
        for name, column in columns.items():
            assert column.dtype == precise[name].dtype, name
            assert column.tobytes() == precise[name].tobytes(), name
    return True


def seeds() -> dict[str, bytes]:
    """First inputs: the documentation's examples; the same about `MANIFEST`, sound and not."""
    found = {f"{name}.json": example_text(name).encode() for name in DOCUMENT_NAMES}
    for name in ("planning", "strategy"):
        example = json.loads(found[f"{name}.json"])
        for kind, keys in {"sound": SMALL, "repeated": ("s0", "s0"), "short": SMALL[:1]}.items():
            pairs = zip(keys, example["predictions"], strict=False)
            answers = [{**answer, "sample_id": key} for key, answer in pairs]
            document = {**example, "split": MANIFEST.name, "predictions": answers}
            found[f"{kind}-{name}.json"] = json.dumps(document).encode()
        found[f"sound-{name}.json.gz"] = gzip.compress(found[f"sound-{name}.json"], mtime=0)
    return found
