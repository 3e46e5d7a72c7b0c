"""Files on this machine: read, checked with the checker that the server uses, and written."""

import csv
import gzip
import io
import os
from collections.abc import Iterable, Sequence
from pathlib import Path

from pydantic import ValidationError

from exceptiondrive.errors import InvalidArgumentError
from exceptiondrive_schemas.challenges import ChallengeId
from exceptiondrive_schemas.check import MAX_UPLOAD_BYTES, check_bytes
from exceptiondrive_schemas.faults import CheckReport
from exceptiondrive_schemas.printable import spreadsheet_text
from exceptiondrive_schemas.protocol import (
    ProtocolDocument,
    ProtocolError,
    packaged_protocol,
    parse_protocol,
)
from exceptiondrive_schemas.split import Manifest, Split


def check_file(
    file: str | os.PathLike[str],
    *,
    manifest: Manifest | None = None,
    protocol: ProtocolDocument | None = None,
    challenge: ChallengeId | None = None,
    max_upload_bytes: int = MAX_UPLOAD_BYTES,
) -> CheckReport:
    """Check a submission file and list every fault in it.

    Args:
        file: Path of the file, JSON or gzip of JSON.
        manifest: Samples of the split; without it only the form of the file is checked.
        protocol: Waypoints and bounds; without it the one that ships with the client.
        challenge: The challenge that the file must be for; any, if None.
        max_upload_bytes: Most bytes of the file itself.

    Returns:
        The report; `report.is_valid` says whether the file can be scored.

    Raises:
        InvalidArgumentError: The file cannot be read.
    """
    return check_bytes(
        read_file(file),
        manifest=manifest,
        protocol=protocol or packaged_protocol(),
        challenge=challenge,
        max_upload_bytes=max_upload_bytes,
    )


def manifest_of(split: Split, protocol: ProtocolDocument) -> Manifest:
    """Return what is known of a split that is at hand: recorded drives too."""
    whole = split.model_copy(update={"recorded_is_public": True})
    return Manifest.of(whole, protocol.geometry, revision=split.revision)


def read_file(file: str | os.PathLike[str]) -> bytes:
    """Return the bytes of a file, or say why not.

    Raises:
        InvalidArgumentError: No such file, or it cannot be read.
    """
    try:
        return Path(file).read_bytes()
    except OSError as error:
        raise InvalidArgumentError(
            "unreadable_file", f"{os.fspath(file)} cannot be read: {error.strerror}."
        ) from None


def read_manifest(path: Path) -> Manifest:
    """Return the public manifest of a split.

    Raises:
        InvalidArgumentError: No such file, or it is no manifest.
    """
    try:
        return Manifest.read(read_file(path))
    except ValidationError:
        raise InvalidArgumentError(
            "wrong_manifest",
            f"{path.name} is not a manifest.",
            "Take it from the server: exceptiondrive manifest PHASE -o FILE",
        ) from None


def write_file(path: Path, text: str) -> int:
    """Write in one step, compressed if the name ends in `.gz`; return the size in bytes.

    Raises:
        InvalidArgumentError: It cannot be written.
    """
    data = text.encode()
    part = path.with_name(f".{path.name}.part")
    try:
        part.write_bytes(gzip.compress(data, mtime=0) if path.suffix == ".gz" else data)
        size_bytes = part.stat().st_size
        os.replace(part, path)
    except OSError as error:
        raise InvalidArgumentError(
            "unwritable_file", f"{path} cannot be written: {error.strerror}."
        ) from None
    return size_bytes


def csv_text(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a CSV file with a header; what is undefined stands as an empty cell."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(
        [spreadsheet_text(each) if isinstance(each, str) else each for each in row] for row in rows
    )
    return text.getvalue()


def chosen_protocol(choice: str | Path | None) -> ProtocolDocument:
    """Return a protocol by its TOML file or a version that ships; by default the one that ships.

    Raises:
        InvalidArgumentError: Neither a file nor a version, or a file that is no protocol.
    """
    if choice is None:
        return packaged_protocol()
    path = Path(choice)
    try:
        if path.is_file():
            return parse_protocol(path.read_text(encoding="utf-8-sig"))
        return packaged_protocol(str(choice))
    except ProtocolError as error:
        raise InvalidArgumentError("wrong_protocol", f"{choice}: {error}") from None
    except UnicodeDecodeError:
        raise InvalidArgumentError(
            "wrong_protocol", f"{choice} is not UTF-8 text; a protocol is a TOML file."
        ) from None
    except OSError:
        raise InvalidArgumentError(
            "wrong_protocol",
            f"{str(choice)!r} is neither a protocol file nor a version that ships with this "
            "client.",
            "The server gives every version as a file at /api/v1/protocols/VERSION?format=toml.",
        ) from None
