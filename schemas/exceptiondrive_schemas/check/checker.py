"""Checks a submission file: all faults in one pass, or its content ready for scoring."""

import hashlib
from dataclasses import dataclass

from exceptiondrive_schemas.challenges import ChallengeId
from exceptiondrive_schemas.check.answers import CheckedDocument
from exceptiondrive_schemas.check.findings import Findings
from exceptiondrive_schemas.check.inflate import (
    MAX_INFLATED_BYTES,
    MAX_UPLOAD_BYTES,
    UnreadableFileError,
    inflate,
)
from exceptiondrive_schemas.check.submission_reader import SubmissionReader
from exceptiondrive_schemas.faults import CheckReport, FaultCode
from exceptiondrive_schemas.protocol import Protocol
from exceptiondrive_schemas.split import Manifest

UTF8_BYTE_ORDER_MARK = b"\xef\xbb\xbf"


@dataclass(frozen=True)
class Checked:
    """The outcome of a check.

    Attributes:
        report: What is wrong, for people and programs.
        document: What the file says; None where anything is wrong.
    """

    report: CheckReport
    document: CheckedDocument | None


def check(
    data: bytes,
    *,
    protocol: Protocol,
    manifest: Manifest | None = None,
    challenge: ChallengeId | None = None,
    max_upload_bytes: int = MAX_UPLOAD_BYTES,
    max_inflated_bytes: int = MAX_INFLATED_BYTES,
) -> Checked:
    """Check a submission file and keep what it says.

    Never raises for anything that is in the file, never holds more than a few times its inflated
    size, and reads it once.

    Args:
        data: The file, plain JSON or gzip.
        protocol: Gives waypoints, bounds, tasks and the frame check.
        manifest: Sample ids of the split; without it ids are only checked for duplicates.
        challenge: The challenge that the file must be for; any, if None.
        max_upload_bytes: Most bytes of the file itself.
        max_inflated_bytes: Most bytes of JSON in it.
    """
    findings = Findings()
    try:
        text = inflate(
            data, max_upload_bytes=max_upload_bytes, max_inflated_bytes=max_inflated_bytes
        )
    except UnreadableFileError as error:
        findings.add(error.code, (), expected=error.expected, got=error.got)
        return Checked(_report(data, findings), None)
    reader = SubmissionReader(
        _without_byte_order_mark(text, findings),
        protocol=protocol,
        manifest=manifest,
        challenge=challenge,
        findings=findings,
    )
    document = reader.read()
    return Checked(_report(data, findings, reader), document)


def check_bytes(
    data: bytes,
    *,
    protocol: Protocol,
    manifest: Manifest | None = None,
    challenge: ChallengeId | None = None,
    max_upload_bytes: int = MAX_UPLOAD_BYTES,
    max_inflated_bytes: int = MAX_INFLATED_BYTES,
) -> CheckReport:
    """Return the report of `check` alone."""
    return check(
        data,
        protocol=protocol,
        manifest=manifest,
        challenge=challenge,
        max_upload_bytes=max_upload_bytes,
        max_inflated_bytes=max_inflated_bytes,
    ).report


def _without_byte_order_mark(text: bytes, findings: Findings) -> bytes:
    if not text.startswith(UTF8_BYTE_ORDER_MARK):
        return text
    findings.add(
        FaultCode.BYTE_ORDER_MARK, (), expected="JSON from the first byte on", got="EF BB BF"
    )
    return text[len(UTF8_BYTE_ORDER_MARK) :]


def _report(data: bytes, findings: Findings, reader: SubmissionReader | None = None) -> CheckReport:
    return CheckReport(
        challenge=reader.challenge if reader else None,
        split=reader.split if reader else None,
        n_predictions=reader.n_predictions if reader else None,
        digest=f"sha256:{hashlib.sha256(data).hexdigest()}",
        size_bytes=len(data),
        faults=findings.groups(),
        notes=tuple(reader.notes) if reader else (),
    )
