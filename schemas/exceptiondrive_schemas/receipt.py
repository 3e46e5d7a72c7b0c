"""Receipts: the server's signed statement about a scored submission, which anyone can verify later.

A receipt contains only what never changes: which bytes were sent, what scored them, and what was
published. Every field has its own digest and the signature covers the digests, so a check can name
the field that was altered.
"""

import hashlib
from datetime import datetime
from typing import Literal

from pydantic import ConfigDict, Field

from exceptiondrive_schemas.base import Document, canonical_json, content_digest
from exceptiondrive_schemas.challenges import ChallengeId
from exceptiondrive_schemas.score_sheet import BreakdownRow, MetricRow, ProtocolRef
from exceptiondrive_schemas.split import SplitRef


class ReceiptStatement(Document):
    """What is signed: one submission under one protocol and split revision, as published.

    Fields of a newer server are kept: they are signed too, and checked like the others.
    """

    model_config = ConfigDict(extra="allow")

    submission_id: str
    file_digest: str
    """`sha256:` and the hex digest of the bytes that were sent."""
    size_bytes: int
    phase: str
    challenge: ChallengeId
    team: str
    method: str
    protocol: ProtocolRef
    split: SplitRef
    scorer_version: str
    n: int
    """Samples that count."""
    micro: MetricRow
    macro_family: MetricRow
    families: dict[str, BreakdownRow]
    sheet_digest: str
    """Content digest of the whole published score sheet."""
    received_at: datetime
    scored_at: datetime


class Receipt(Document):
    """A statement, the digest of each of its fields, and the signature of those digests."""

    schema_: Literal["exceptiondrive.receipt/1"] = Field(
        default="exceptiondrive.receipt/1", alias="schema"
    )
    statement: ReceiptStatement
    digests: dict[str, str]
    """Field of the statement to the digest of its value: `sha256:` and the hex digest of its canonical JSON (keys
    sorted, no blanks, UTF-8 unescaped, numbers as they stand here: `0.0` is not `0`)."""
    algorithm: Literal["ed25519"] = "ed25519"
    key_id: str
    """Which of `/api/v1/receipt-keys` signed."""
    signature: str
    """Base64 of the Ed25519 signature of the canonical JSON of `{"schema": ..., "key_id": ..., "digests": ...}`, as these
    stand here."""


class ReceiptKey(Document):
    """The public half of a key that signs receipts, or has signed some."""

    key_id: str
    """The first 16 hex digits of the SHA-256 of the public key."""
    algorithm: Literal["ed25519"] = "ed25519"
    public_key: str
    """Base64 of the 32 bytes."""
    first_used_at: datetime
    is_current: bool


class ReceiptKeys(Document):
    """All keys of a server; old ones stay, so that old receipts can still be checked."""

    schema_: Literal["exceptiondrive.receipt-keys/1"] = Field(
        default="exceptiondrive.receipt-keys/1", alias="schema"
    )
    server: str | None = None
    keys: tuple[ReceiptKey, ...]


def key_id_of(public_key: bytes) -> str:
    """Return the id of a key: the first 16 hex digits of the SHA-256 of its public half."""
    return hashlib.sha256(public_key).hexdigest()[:16]


def field_digests(statement: ReceiptStatement) -> dict[str, str]:
    """Return the content digest of every field of a statement."""
    document = statement.model_dump(mode="json", by_alias=True)
    return {field: content_digest(value) for field, value in document.items()}


def signed_bytes(key_id: str, digests: dict[str, str]) -> bytes:
    """Return the bytes that a signature covers: form, key and digests as canonical JSON."""
    form = "exceptiondrive.receipt/1"
    return canonical_json({"schema": form, "key_id": key_id, "digests": digests})


def altered_fields(receipt: Receipt) -> tuple[str, ...]:
    """Return the fields of the statement that do not match their signed digests."""
    found = field_digests(receipt.statement)
    names = {*found, *receipt.digests}
    return tuple(sorted(name for name in names if found.get(name) != receipt.digests.get(name)))
