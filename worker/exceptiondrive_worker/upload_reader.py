"""Read the bytes of an upload into answers as columns, or into a report of all its faults.

There are two readers with one verdict. The fast one decodes a fixed shape and checks whole arrays;
it only ever says "sound" or "not sure". If it is not sure, the precise checker decides, which the
client runs, too. So only faulty or unusual files pay for the precise report.
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
"""A challenge that is missing here uses the precise checker only."""


def read_upload(
    data: bytes,
    challenge: Challenge,
    manifest: Manifest,
    protocol: ProtocolDocument,
) -> Columns | CheckReport:
    """Read an upload completely, or report everything that is wrong with it.

    It is plain JSON or gzip. The server has checked its size; here the inflated JSON is limited.

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
