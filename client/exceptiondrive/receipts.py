"""Check receipts on this machine, without the server; needs the extra `receipts`.

A server's public keys are remembered, with its address, when a receipt is fetched, so that a later
check needs nothing else; a check can also be given a file of keys that came by another way. The id
of a key is worked out from the key wherever keys are read: no server names its key like another's.
"""

import base64
import json
import os
from dataclasses import dataclass
from pathlib import Path

from pydantic import ValidationError

from exceptiondrive.credentials import credentials_path
from exceptiondrive.errors import InvalidArgumentError, extra_missing
from exceptiondrive.inputs import given_bytes
from exceptiondrive.settings import write_settings_file
from exceptiondrive.waypoint_rows import with_unique_keys
from exceptiondrive_schemas.receipt import (
    Receipt,
    ReceiptKey,
    ReceiptKeys,
    altered_fields,
    key_id_of,
    signed_bytes,
)

_FETCH = "Fetch it anew: exceptiondrive receipt get ID -o FILE"


class ReceiptError(InvalidArgumentError):
    """The receipt does not hold; `altered` names the fields that are not what was signed."""

    def __init__(
        self, code: str, sentence: str, altered: tuple[str, ...] = (), cure: str = _FETCH
    ) -> None:
        self.altered = altered
        super().__init__(code, sentence, cure)


class KnownKey(ReceiptKey):
    """A public key, and the server that gave it; None where a file of keys does not say."""

    server: str | None = None


class KnownKeys(ReceiptKeys):
    """Keys of any number of servers, as they are remembered."""

    keys: tuple[KnownKey, ...]


@dataclass(frozen=True)
class Verdict:
    """A receipt that holds, the key that signed it, and the servers that gave this key."""

    receipt: Receipt
    key: ReceiptKey
    servers: tuple[str, ...]


def verify_receipt(
    file: str | os.PathLike[str], *, keys: str | os.PathLike[str] | None = None
) -> Verdict:
    """Check a receipt offline.

    Args:
        file: The receipt.
        keys: File of the server's public keys (`exceptiondrive receipt keys -o FILE`); else the
            ones remembered on this machine.

    Raises:
        ReceiptError: It was altered, or the key is not known.
        InvalidArgumentError: A file cannot be read, a name stands twice in the receipt, a key does not
            fit its id, or the extra `receipts` is missing.
    """
    receipt = _read_receipt(file)
    known = remembered_keys() if keys is None else read_keys(Path(keys))
    named = [key for key in known if key.key_id == receipt.key_id]
    altered = altered_fields(receipt)
    if altered:
        names = ", ".join(altered)
        raise ReceiptError("receipt_altered", f"The receipt was altered: {names}.", altered)
    if not named:
        raise ReceiptError(
            "receipt_key_unknown",
            f"The key {receipt.key_id!r} of the receipt is not among the known keys.",
            cure="Fetch the server's: exceptiondrive receipt keys -o keys.json; then add --key keys.json",
        )
    if not _is_signed(receipt, named[0]):
        raise ReceiptError(
            "receipt_altered",
            "The receipt was altered: its signature does not fit.",
            ("digests", "signature"),
        )
    return Verdict(receipt, named[0], tuple(key.server for key in named if key.server))


def keys_path() -> Path:
    """Where public keys of servers are remembered."""
    return credentials_path().with_name("receipt-keys.json")


def read_keys(path: Path) -> tuple[KnownKey, ...]:
    """Return the keys in a file.

    Raises:
        InvalidArgumentError: It cannot be read, is no file of keys, or a key does not fit its id.
    """
    try:
        found = KnownKeys.read(given_bytes(path).data)
    except ValidationError:
        raise InvalidArgumentError(
            "wrong_keys", f"{path} is no file of receipt keys.", "Run: exceptiondrive receipt keys"
        ) from None
    require_true_ids(found, str(path))
    return tuple(_known_key(key, key.server or found.server) for key in found.keys)


def remembered_keys() -> tuple[KnownKey, ...]:
    """Return the keys that are remembered on this machine; none where no receipt was fetched.

    Raises:
        InvalidArgumentError: As of `read_keys`.
    """
    path = keys_path()
    return read_keys(path) if path.exists() else ()


def remember_keys(found: ReceiptKeys) -> Path:
    """Remember public keys of a server on this machine; what is known already stays as it is.

    Raises:
        InvalidArgumentError: A key does not fit its id, or the file of known keys is none or cannot be
            written.
    """
    require_true_ids(found, found.server or "The server")
    held = {(key.key_id, key.server): key for key in remembered_keys()}
    for key in found.keys:
        held.setdefault((key.key_id, found.server), _known_key(key, found.server))
    kept = KnownKeys(keys=tuple(held.values()))
    return write_settings_file(keys_path(), kept.model_dump_json(by_alias=True))


def require_true_ids(found: ReceiptKeys, whose: str) -> None:
    """Refuse keys whose ids are not their own.

    Args:
        found: The keys.
        whose: The server or file that they come from.

    Raises:
        InvalidArgumentError: An id is not worked out from its key.
    """
    for key in found.keys:
        if not _has_true_id(key):
            raise InvalidArgumentError(
                "wrong_keys",
                f"{whose} gives a key under the id {key.key_id!r}, which is not the id of that key; "
                "none of its keys was taken.",
                "Do not trust these keys: take them from the benchmark's web page.",
            )


def _has_true_id(key: ReceiptKey) -> bool:
    try:
        return key.key_id == key_id_of(base64.b64decode(key.public_key, validate=True))
    except ValueError:
        return False


def _known_key(key: ReceiptKey, server: str | None) -> KnownKey:
    known_here = {name: getattr(key, name) for name in ReceiptKey.model_fields}
    return KnownKey(**known_here, server=server)


def _read_receipt(file: str | os.PathLike[str]) -> Receipt:
    given = given_bytes(file)
    try:
        receipt = Receipt.read(given.data)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        raise ReceiptError(
            "receipt_altered", f"This is no receipt: {where or 'file'}: {first['msg']}.", (where,)
        ) from None
    json.loads(given.data, object_pairs_hook=with_unique_keys(Path(given.name)), parse_int=str)
    return receipt


def _is_signed(receipt: Receipt, key: ReceiptKey) -> bool:
    try:
        from cryptography.exceptions import InvalidSignature
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
    except ImportError:
        raise extra_missing("Checking a signature needs cryptography.", "receipts") from None
    try:
        public_key = Ed25519PublicKey.from_public_bytes(base64.b64decode(key.public_key))
        signature = base64.b64decode(receipt.signature, validate=True)
        public_key.verify(signature, signed_bytes(receipt.key_id, receipt.digests))
    except (InvalidSignature, ValueError):
        return False
    return True
