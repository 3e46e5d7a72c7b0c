"""Signs receipts with Ed25519. The private key is one file (0600), read or created on first use.

To rotate it, replace the file (`exceptiondrive-server new-receipt-key`) and restart. Public keys are
recorded when they first sign, and stay published, so older receipts can still be checked.
"""

import base64
import os
import threading
from pathlib import Path

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)

from exceptiondrive_records.db.database import Database
from exceptiondrive_records.db.errors import StoreError
from exceptiondrive_records.submissions.receipt_keys import receipt_keys, remember_receipt_key
from exceptiondrive_schemas.receipt import (
    Receipt,
    ReceiptKey,
    ReceiptStatement,
    field_digests,
    key_id_of,
    signed_bytes,
)


class ReceiptSigner:
    """Signs statements with the key in one file.

    Args:
        key_file: PEM of an Ed25519 private key; made with mode 0600 where there is none.
        database: Where public keys are recorded.
    """

    def __init__(self, key_file: Path, database: Database) -> None:
        self._key_file = key_file
        self._database = database
        self._lock = threading.Lock()
        self._loaded: tuple[Ed25519PrivateKey, str] | None = None

    def sign(self, statement: ReceiptStatement) -> Receipt:
        """Return the receipt; the same statement and key always give the same bytes."""
        key, key_id = self._key()
        digests = field_digests(statement)
        signature = key.sign(signed_bytes(key_id, digests))
        return Receipt(
            statement=statement,
            digests=digests,
            key_id=key_id,
            signature=base64.b64encode(signature).decode("ascii"),
        )

    def keys(self) -> tuple[ReceiptKey, ...]:
        """Return the public keys, those of former years first."""
        current = self._key()[1]
        with self._database.read() as session:
            return tuple(
                ReceiptKey(
                    key_id=row.key_id,
                    public_key=row.public_key,
                    first_used_at=row.first_used_at,
                    is_current=row.key_id == current,
                )
                for row in receipt_keys(session)
            )

    def _key(self) -> tuple[Ed25519PrivateKey, str]:
        with self._lock:
            if self._loaded is None:
                key = read_or_make_key(self._key_file)
                public_key = key.public_key().public_bytes_raw()
                key_id = key_id_of(public_key)
                with self._database.write() as session:
                    text = base64.b64encode(public_key).decode("ascii")
                    remember_receipt_key(session, key_id, text)
                self._loaded = key, key_id
            return self._loaded


def read_or_make_key(path: Path) -> Ed25519PrivateKey:
    """Read the private key, or make it; of several processes that make it, one wins.

    Raises:
        StoreError: The file cannot be read or made, or holds no Ed25519 key.
    """
    try:
        if not path.exists():
            write_new_key(path, replace=False)
        key = load_pem_private_key(path.read_bytes(), password=None)
    except (OSError, ValueError, TypeError):
        raise StoreError("Receipts cannot be signed: the server's key cannot be read.") from None
    if not isinstance(key, Ed25519PrivateKey):
        raise StoreError("Receipts cannot be signed: the server's key is not an Ed25519 key.")
    return key


def new_key_pem() -> bytes:
    """Return a new private key, as its file holds it."""
    key = Ed25519PrivateKey.generate()
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())


def write_new_key(path: Path, *, replace: bool) -> None:
    """Make a private key: written beside the file with mode 0600, then moved to its name.

    A key that is there stays, unless it is to be replaced.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f"{path.name}.{os.getpid()}.part")
    part.unlink(missing_ok=True)
    descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(descriptor, "wb") as stream:
        stream.write(new_key_pem())
    if replace:
        part.replace(path)
        return
    try:
        os.link(part, path)  # unlike a rename, this never replaces another's key
    except FileExistsError:
        pass
    finally:
        part.unlink()
