"""From the bytes of an upload to answers as columns, or to the report of all its faults.

Two readers with one verdict. The fast one decodes a fixed shape and checks whole arrays; it only
ever says "sound" or "not sure". Whatever it is not sure of goes to the precise checker, which the
client runs too, and which decides. So only a faulty or an unusual file pays for the precise report.
"""

from collections.abc import Callable

from zlib_ng import zlib_ng

from exceptiondrive_schemas.challenges import PLANNING, STRATEGY, Challenge, ChallengeId
from exceptiondrive_schemas.check import (
    MAX_INFLATED_BYTES,
    UnreadableFileError,
    check,
    inflate,
)
from exceptiondrive_schemas.faults import CheckReport
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.split import Manifest
from exceptiondrive_scoring.aliases import Columns
from exceptiondrive_scoring.challenge import document_columns
from exceptiondrive_worker.fast_planning import read_planning
from exceptiondrive_worker.fast_strategy import read_strategy

FastReader = Callable[[bytes, Manifest, ProtocolDocument], Columns | None]

FAST_READERS: dict[ChallengeId, FastReader] = {
    PLANNING.id: read_planning,
    STRATEGY.id: read_strategy,
}
"""Files of a challenge without one are read by the precise checker alone."""


def read_upload(
    data: bytes,
    challenge: Challenge,
    manifest: Manifest,
    protocol: ProtocolDocument,
) -> Columns | CheckReport:
    """Read an upload completely, or say everything that is wrong with it.

    It is plain JSON or gzip. The server has judged its size; the JSON in it is bounded here.

    Returns:
        Named arrays in the order of the manifest, as `ChallengeScoring.measure` takes them; or the
        report with every fault.
    """
    try:
        text = inflate(data, max_upload_bytes=MAX_INFLATED_BYTES, library=zlib_ng)
        fast_reader = FAST_READERS.get(challenge.id)
        columns = fast_reader(text, manifest, protocol) if fast_reader else None
    except UnreadableFileError:
        columns = None
    if columns is not None:
        return columns
    checked = check(
        data,
        protocol=protocol,
        manifest=manifest,
        challenge=challenge.id,
        max_upload_bytes=MAX_INFLATED_BYTES,
    )
    if checked.document is None:
        return checked.report.to_keep()
    return document_columns(checked.document, manifest.sample_ids)
