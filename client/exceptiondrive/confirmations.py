"""Sign, with a key kept off all servers, that a split may be scored under a protocol.

Needs the extra `receipts`. The public half of the key stands beside the split, in `floors.toml`.
"""

import base64
import os
from pathlib import Path
from typing import TYPE_CHECKING

from exceptiondrive.errors import InvalidArgumentError, extra_missing
from exceptiondrive.settings import config_folder
from exceptiondrive_schemas.api.confirmation import Confirmation, confirmed_bytes
from exceptiondrive_schemas.split import SplitRef

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey


def default_key_path() -> Path:
    """Where an organizer's private key lies unless told otherwise."""
    return config_folder() / "organizer-key.pem"


def make_key(path: Path) -> str:
    """Return the public half of a key, in base64; a key that is not there is made, with mode 0600.

    Raises:
        InvalidArgumentError: The file is no key, cannot be written, or cryptography is missing.
    """
    if not os.path.exists(path):
        pem = _new_key()
        try:
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as out:
                out.write(pem)
        except OSError as error:
            raise InvalidArgumentError(
                "wrong_key", f"{path} cannot be written ({error.strerror})."
            ) from None
    return _public_half(_read_key(path))


def confirm(split: SplitRef, protocol_digest: str, key: Path) -> Confirmation:
    """Sign that a split may be scored under a protocol.

    Args:
        split: At the very revision.
        protocol_digest: Of the document that was read on this machine.
        key: File of the private key.

    Raises:
        InvalidArgumentError: The file is no key, or cryptography is missing.
    """
    private = _read_key(key)
    signature = private.sign(confirmed_bytes(split, protocol_digest))
    return Confirmation(
        split=split,
        protocol=protocol_digest,
        public_key=_public_half(private),
        signature=base64.b64encode(signature).decode(),
    )


def _public_half(key: "Ed25519PrivateKey") -> str:
    return base64.b64encode(key.public_key().public_bytes_raw()).decode()


def _new_key() -> bytes:
    try:
        from cryptography.hazmat.primitives import serialization
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    except ImportError:
        raise extra_missing("Signing needs cryptography.", "receipts") from None
    return Ed25519PrivateKey.generate().private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )


def _read_key(path: Path) -> "Ed25519PrivateKey":
    try:
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
        from cryptography.hazmat.primitives.serialization import load_pem_private_key
    except ImportError:
        raise extra_missing("Signing needs cryptography.", "receipts") from None
    try:
        key = load_pem_private_key(path.read_bytes(), password=None)
    except (OSError, ValueError, TypeError):
        key = None
    if not isinstance(key, Ed25519PrivateKey):
        raise InvalidArgumentError(
            "wrong_key",
            f"{path} is no Ed25519 key.",
            "Make one: exceptiondrive organizer protocols key",
        )
    return key
