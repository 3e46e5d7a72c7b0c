"""Check receipts on this machine, without the server; needs the extra `receipts`.

The server's public keys are remembered when a receipt is fetched, so that a later check needs
nothing else; a check can also be given a file of keys that came by another way.
"""

import base64
import os
from dataclasses import dataclass
from pathlib import Path

from pydantic import ValidationError

from exceptiondrive.credentials import credentials_path
from exceptiondrive.errors import InvalidArgumentError
from exceptiondrive.inputs import given_bytes
from exceptiondrive_schemas.receipt import (
    Receipt,
    ReceiptKey,
    ReceiptKeys,
    altered_fields,
    signed_bytes,
)


class ReceiptError(InvalidArgumentError):
    """The receipt does not hold; `altered` names the fields that are not what was signed."""

    def __init__(self, code: str, sentence: str, altered: tuple[str, ...] = ()) -> None:
        self.altered = altered
        super().__init__(code, sentence, "Fetch it anew: exceptiondrive receipt get ID -o FILE")


@dataclass(frozen=True)
class Verdict:
    """A receipt that holds, and the key that signed it."""

    receipt: Receipt
    key: ReceiptKey


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
        InvalidArgumentError: A file cannot be read, or the extra `receipts` is missing.
    """
    receipt = _read_receipt(file)
    known = read_keys(keys_path() if keys is None else Path(keys))
    key = next((key for key in known if key.key_id == receipt.key_id), None)
    altered = altered_fields(receipt)
    if altered:
        names = ", ".join(altered)
        raise ReceiptError("receipt_altered", f"The receipt was altered: {names}.", altered)
    if key is None:
        raise ReceiptError(
            "receipt_key_unknown",
            f"The key {receipt.key_id!r} of the receipt is not among the known keys.",
        )
    if not _is_signed(receipt, key):
        raise ReceiptError(
            "receipt_altered",
            "The receipt was altered: its signature does not fit.",
            ("digests", "signature"),
        )
    return Verdict(receipt, key)


def keys_path() -> Path:
    """Where public keys of servers are remembered."""
    return credentials_path().with_name("receipt-keys.json")


def read_keys(path: Path) -> tuple[ReceiptKey, ...]:
    """Return the keys in a file; none where the file is missing.

    Raises:
        InvalidArgumentError: It is no file of keys.
    """
    if not path.exists():
        return ()
    try:
        return ReceiptKeys.read(given_bytes(path).data).keys
    except ValidationError:
        raise InvalidArgumentError(
            "wrong_keys", f"{path} is no file of receipt keys.", "Run: exceptiondrive receipt keys"
        ) from None


def remember_keys(found: ReceiptKeys) -> Path:
    """Remember public keys on this machine; a key that is known already stays as it is."""
    path = keys_path()
    known = read_keys(path)
    ids = {key.key_id for key in known}
    keys = (*known, *(key for key in found.keys if key.key_id not in ids))
    path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    part = path.with_name(f"{path.name}.{os.getpid()}.part")
    part.write_text(ReceiptKeys(keys=keys).model_dump_json(by_alias=True), encoding="utf-8")
    part.replace(path)
    return path


def _read_receipt(file: str | os.PathLike[str]) -> Receipt:
    try:
        return Receipt.read(given_bytes(file).data)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        raise ReceiptError(
            "receipt_altered", f"This is no receipt: {where or 'file'}: {first['msg']}.", (where,)
        ) from None


def _is_signed(receipt: Receipt, key: ReceiptKey) -> bool:
    try:
        from cryptography.exceptions import InvalidSignature
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
    except ImportError:
        raise InvalidArgumentError(
            "receipts_missing",
            "Checking a signature needs the package cryptography.",
            "Install it: pip install 'exceptiondrive[receipts]'",
        ) from None
    try:
        public_key = Ed25519PublicKey.from_public_bytes(base64.b64decode(key.public_key))
        signature = base64.b64decode(receipt.signature, validate=True)
        public_key.verify(signature, signed_bytes(receipt.key_id, receipt.digests))
    except (InvalidSignature, ValueError):
        return False
    return True
