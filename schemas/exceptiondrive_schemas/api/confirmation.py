"""Confirmations: an organizer signs that a split may be scored under a protocol.

The key is the organizer's own and never on the server. Accepted keys are listed beside the split,
where only workers read (`floors.toml`), so nobody who controls the server can confirm anything.
"""

import hashlib
from typing import Annotated, Literal

from pydantic import Field

from exceptiondrive_schemas.base import Document, canonical_json
from exceptiondrive_schemas.split import SplitRef

PublicKey = Annotated[str, Field(pattern=r"^[A-Za-z0-9+/]{43}=$")]
"""Base64 of the 32 bytes of an Ed25519 public key."""


class Confirmation(Document):
    """What one organizer signed."""

    schema_: Literal["exceptiondrive.confirmation/1"] = Field(
        default="exceptiondrive.confirmation/1", alias="schema"
    )
    split: SplitRef
    protocol: Annotated[str, Field(max_length=100)]
    """Content digest of the protocol."""
    public_key: PublicKey
    signature: Annotated[str, Field(pattern=r"^[A-Za-z0-9+/]{86}==$")]
    """Base64 of the Ed25519 signature of the object of `schema`, `split` and `protocol` as JSON in UTF-8, its keys
    sorted and without blanks."""

    @property
    def id(self) -> str:
        """Its id on a site: the same statement and key give the same id."""
        signed = confirmed_bytes(self.split, self.protocol) + self.public_key.encode()
        return hashlib.sha256(signed).hexdigest()[:16]


def confirmed_bytes(split: SplitRef, protocol_digest: str) -> bytes:
    """Return the bytes to sign: form, split and protocol as canonical JSON."""
    return canonical_json(
        {
            "schema": "exceptiondrive.confirmation/1",
            "split": {"name": split.name, "revision": split.revision},
            "protocol": protocol_digest,
        }
    )
