"""Files on this machine: read, checked with the checker that the server uses, and written."""

import csv
import gzip
import io
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from exceptiondrive.errors import InvalidArgumentError, extra_missing
from exceptiondrive.inputs import (
    ManifestLike,
    ProtocolLike,
    SubmissionLike,
    given_manifest,
    given_protocol,
    given_submission,
    require_name,
)
from exceptiondrive_schemas.base import faults_in
from exceptiondrive_schemas.challenges import ChallengeId
from exceptiondrive_schemas.check import MAX_UPLOAD_BYTES, check
from exceptiondrive_schemas.check.fault_list import FaultList
from exceptiondrive_schemas.check.strategy_rules import StrategyRules
from exceptiondrive_schemas.faults import CheckReport, FaultCode
from exceptiondrive_schemas.printable import spreadsheet_text
from exceptiondrive_schemas.protocol import ProtocolDocument, packaged_protocol
from exceptiondrive_schemas.split import Manifest, Split


def check_file(
    file: SubmissionLike,
    *,
    manifest: ManifestLike | Split | None = None,
    protocol: ProtocolLike | None = None,
    challenge: ChallengeId | None = None,
    max_upload_bytes: int = MAX_UPLOAD_BYTES,
) -> CheckReport:
    """Check a submission and list every fault in it.

    Args:
        file: The submission: a path (JSON or gzip of JSON), bytes, an open file, a mapping, arrays
            or a data frame; see `exceptiondrive.inputs`.
        manifest: Samples of the split, in any of these forms, or the split; without it only the form
            of the file is checked.
        protocol: Waypoints and bounds: a document, the path of its TOML file, or a version; without
            it the one that ships with the client.
        challenge: The challenge that the file must be for, where the manifest names none; any, if None.
        max_upload_bytes: Most bytes of the file itself.

    Returns:
        The report; `report.is_valid` says whether the file can be scored.

    Raises:
        InvalidArgumentError: The file, the manifest or the protocol cannot be read.
    """
    rules = given_protocol(protocol)
    if isinstance(manifest, Split):
        manifest = manifest_of(manifest, rules)
    known = None if manifest is None else given_manifest(manifest)
    return check(
        given_submission(file, None if known is None else known.name).data,
        manifest=known,
        protocol=rules,
        challenge=challenge,
        max_upload_bytes=max_upload_bytes,
    ).report


def faults_of_strategy(prediction: dict[str, Any]) -> tuple[str, ...]:
    """Say what is wrong with one prediction of the strategy challenge, whatever the protocol.

    Which hazard types there are is a matter of the protocol, and not asked.
    """
    faults = FaultList()
    StrategyRules(packaged_protocol(), faults).answer(prediction, (), None)
    faults.forget(FaultCode.UNKNOWN_HAZARD_TYPE)
    return tuple(
        f"{each.path.removeprefix('$.')}: expected {each.expected}, got {each.got}"
        for group in faults.groups()
        for each in group.examples
    )


def manifest_of(split: Split, protocol: ProtocolDocument) -> Manifest:
    """Return what a check asks of a split that is at hand: recorded drives too, but no revision.

    Its digest would take longer than the check.

    Raises:
        InvalidArgumentError: Its recorded drives have other waypoints than the protocol.
    """
    whole = split.model_copy(update={"recorded_is_public": True})
    try:
        return Manifest.of(whole, protocol.geometry, revision="")
    except ValidationError as error:
        raise InvalidArgumentError(
            "wrong_split_file",
            f"The split does not go with protocol {protocol.version} ({faults_in(error)[0]}).",
        ) from None


def write_file(path: Path, content: str | bytes) -> int:
    """Write in one step, compressed if the name ends in `.gz`; return the size in bytes.

    Behind a symlink its target is replaced; what is no regular file, as a pipe, is written into.

    Raises:
        InvalidArgumentError: It cannot be written.
    """
    require_name(path)
    data = content.encode() if isinstance(content, str) else content
    data = gzip.compress(data, mtime=0) if path.suffix == ".gz" else data
    try:
        if path.exists() and not path.is_file():
            path.write_bytes(data)
        else:
            target = Path(os.path.realpath(path))
            part = target.with_name(f".{target.name}.part")
            try:
                part.write_bytes(data)
                os.replace(part, target)
            finally:
                part.unlink(missing_ok=True)
    except OSError as error:
        raise InvalidArgumentError(
            "unwritable_file", f"{path} cannot be written: {error.strerror}."
        ) from None
    return len(data)


def csv_text(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a CSV file with a header; what is undefined stands as an empty cell."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(
        [spreadsheet_text(each) if isinstance(each, str) else each for each in row] for row in rows
    )
    return text.getvalue()


def parquet_bytes(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> bytes:
    """Return a Parquet file; what is undefined is null.

    Raises:
        InvalidArgumentError: The extra `parquet` is missing.
    """
    try:
        from pyarrow import BufferOutputStream, table
        from pyarrow.parquet import write_table
    except ModuleNotFoundError:
        raise extra_missing("Parquet files need pyarrow.", "parquet") from None
    cells = list(zip(*rows, strict=True)) or [()] * len(columns)
    stream = BufferOutputStream()
    write_table(table(dict(zip(columns, map(list, cells), strict=True))), stream)
    return bytes(stream.getvalue())
