"""Content-addressed store of uploads: written once under their SHA-256, verified when read.

Backends through obstore: a local folder, S3, or memory for tests. A file is on disk, synced and
under its final name before the row that mentions it is written.
"""

import contextlib
import hashlib
import os
import re
import shutil
import stat
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote, urlsplit

import obstore
from obstore.exceptions import AlreadyExistsError, BaseError
from obstore.store import LocalStore, ObjectStore, from_url
from sqlalchemy import select, text
from sqlalchemy.orm import Session

from exceptiondrive_records.db.errors import NotFound, StoreError, UploadTooLarge
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_schemas.base import bytes_digest

if TYPE_CHECKING:
    from obstore.store import RetryConfig

_DIGEST = re.compile(r"sha256:([0-9a-f]{64})")
_NAME = re.compile(r"[0-9a-f]{2}/([0-9a-f]{64})")
LEAST_FREE_BYTES = 64 << 20
LOW_ON_ROOM_BYTES = 1 << 30
"""Below this free space operators are warned; below 64 MiB uploads are refused."""
_IN_MEMORY_BYTES = 1 << 20
_RETRIES: "RetryConfig" = {"max_retries": 3, "retry_timeout": timedelta(seconds=10)}
"""For a store over the network: callers must learn soon that it is unavailable, and retry later."""


class FileDamaged(StoreError):  # noqa: N818
    """The stored bytes do not match their digest; they must never be scored."""

    def __init__(self, digest: str) -> None:
        super().__init__(f"The stored file {digest} is damaged.")


class FileUnreadable(StoreError):  # noqa: N818
    """The store answers, but cannot read this file."""

    def __init__(self, digest: str) -> None:
        super().__init__(f"The stored file {digest} cannot be read.")


@dataclass(frozen=True)
class StoredFile:
    """A file in the store."""

    digest: str
    size_bytes: int
    changed_at: datetime
    """When these bytes were last stored, by the store's clock."""


class FileStore:
    """Files named by the digest of their content. Safe to share between threads."""

    def __init__(self, url: str) -> None:
        """Open the store; a missing folder is created.

        Raises:
            StoreError: The folder cannot be created.
        """
        self._folder = Path(unquote(urlsplit(url).path)) if url.startswith("file:") else None
        try:
            self._store: ObjectStore = (
                LocalStore(self._folder, mkdir=True)
                if self._folder is not None
                else from_url(url, retry_config=_RETRIES)
            )
        except OSError as error:
            raise StoreError(
                f"{self._folder} cannot be the folder of uploads: {str(error).partition(' (os ')[0]}. "
                "Name in EXCEPTIONDRIVE_FILE_STORE_URL a folder, or one that this user may make."
            ) from None

    def put_stream(self, chunks: Iterable[bytes], *, limit_bytes: int) -> tuple[str, int]:
        """Store a file and return its digest and size in bytes. Idempotent.

        Raises:
            UploadTooLarge: It has more than `limit_bytes`.
            StoreError: There is no temporary space for it, or the store did not accept it.
        """
        hashed = hashlib.sha256()
        size_bytes = 0
        with tempfile.SpooledTemporaryFile(max_size=_IN_MEMORY_BYTES) as spooled:
            for chunk in chunks:
                size_bytes += len(chunk)
                if size_bytes > limit_bytes:
                    raise UploadTooLarge(limit_bytes)
                hashed.update(chunk)
                try:
                    spooled.write(chunk)
                except OSError as error:
                    raise StoreError(
                        "The server has no room for the file now; try again later."
                    ) from error
            digest = "sha256:" + hashed.hexdigest()
            self._put(digest, spooled)
        return digest, size_bytes

    def read(self, digest: str, *, limit_bytes: int) -> bytes:
        """Return a stored file, verified against its digest.

        Raises:
            NotFound: No such file.
            UploadTooLarge: It is larger than `limit_bytes`.
            FileDamaged: The stored bytes do not match the digest.
            FileUnreadable: The store answers, but cannot read it.
            StoreError: The store did not answer.
        """
        try:
            found = obstore.get(self._store, _key(digest))
            if found.meta["size"] > limit_bytes:
                raise UploadTooLarge(limit_bytes)
            data = bytes(found.bytes())
        except FileNotFoundError:
            self._require_place(has_files=True)
            raise NotFound("file", digest) from None
        except (BaseError, OSError) as error:
            if self._does_answer():
                raise FileUnreadable(digest) from error
            raise StoreError("The file store does not answer; try again later.") from error
        if bytes_digest(data) != digest:
            raise FileDamaged(digest)
        return data

    def holds(self, digest: str) -> bool:
        """Whether a file with this digest is stored.

        Raises:
            StoreError: The store did not answer.
        """
        return self.changed_at(digest) is not None

    def takes_files(self) -> bool:
        """Whether the store answers and, if it is a folder, is writable and has room."""
        if not self._does_answer():
            return False
        return self._folder is None or (
            self.has_room() and os.access(self._folder, os.W_OK | os.X_OK)
        )

    def has_room(self) -> bool:
        """Whether another file leaves room for records and boards; True if the store is no folder."""
        return self._folder is None or (self.free_bytes() or 0) >= LEAST_FREE_BYTES

    def is_empty(self) -> bool:
        """Whether the folder is empty, as a mount point without its volume; False if unreadable."""
        try:
            return self._folder is not None and not (
                self._folder.is_dir() and any(self._folder.iterdir())
            )
        except OSError:
            return False

    def _does_answer(self) -> bool:
        try:
            self.holds("sha256:" + "0" * 64)
        except StoreError:
            return False
        return True

    def free_bytes(self) -> int | None:
        """Return the free space in bytes; None if the store is no folder, or does not answer."""
        try:
            return None if self._folder is None else shutil.disk_usage(self._folder).free
        except OSError:
            return None

    def stored(self, folder: str | None = None) -> Iterator[StoredFile]:
        """Yield every stored file, or those of a folder, unordered; other files there are ignored.

        Raises:
            StoreError: The store did not answer.
        """
        try:
            for batch in obstore.list(self._store, folder):
                for meta in batch:
                    name = _NAME.fullmatch(meta["path"])
                    if name is not None:
                        changed_at = meta["last_modified"]
                        yield StoredFile("sha256:" + name.group(1), meta["size"], changed_at)
        except (BaseError, OSError) as error:
            raise StoreError("The file store does not answer; try again later.") from error

    def changed_at(self, digest: str) -> datetime | None:
        """Return when a file was last stored, by the store's clock; None if it is not there.

        Raises:
            StoreError: The store did not answer.
        """
        try:
            return obstore.head(self._store, _key(digest))["last_modified"]
        except FileNotFoundError:
            self._require_place()
            return None
        except (BaseError, OSError) as error:
            raise StoreError("The file store does not answer; try again later.") from error

    def remove(self, digest: str) -> None:
        """Remove a stored file that no record mentions; only `remove_orphan` may call this.

        Raises:
            StoreError: The store did not answer.
        """
        try:
            obstore.delete(self._store, _key(digest))
        except FileNotFoundError:
            return
        except (BaseError, OSError) as error:
            raise StoreError("The file store does not answer; try again later.") from error

    def _require_place(self, *, has_files: bool = False) -> None:
        """Raise if the whole folder or bucket is unavailable: then no file counts as missing.

        With `has_files` that includes an empty folder, such as a mount point without its volume.
        """
        if self._folder is None:
            # HEAD does not tell a missing bucket from a missing file, but any listing fails then
            next(self.stored("none"), None)
        elif not self._folder.is_dir() or (has_files and self.is_empty()):
            raise StoreError("The file store does not answer; try again later.")

    def _put(self, digest: str, spooled: tempfile.SpooledTemporaryFile[bytes]) -> None:
        spooled.seek(0)
        key = _key(digest)
        try:
            self._make_subfolder(key)
            try:
                obstore.put(self._store, key, spooled.read(), mode="create")
            except AlreadyExistsError:
                self._heal(key, digest, spooled)
            self._sync(key)  # another process may have put it, and not synced it
        except (BaseError, OSError) as error:
            raise StoreError("The file store does not take files now; try again later.") from error

    def _heal(self, key: str, digest: str, spooled: tempfile.SpooledTemporaryFile[bytes]) -> None:
        """Replace damaged bytes by the right ones, and renew the file's age.

        In other stores than folders, storing it again does both, and costs no more than reading it.
        """
        if self._folder is not None:
            path = self._folder / key
            if bytes_digest(path.read_bytes()) == digest:
                os.utime(path)
                return
        spooled.seek(0)
        obstore.put(self._store, key, spooled.read(), mode="overwrite")

    def _make_subfolder(self, key: str) -> None:
        """Create the folder of a file, with the permissions of the whole store."""
        if self._folder is None:
            return
        subfolder = (self._folder / key).parent
        with contextlib.suppress(FileExistsError, FileNotFoundError):  # obstore reports the problem
            subfolder.mkdir()
            subfolder.chmod(stat.S_IMODE(self._folder.stat().st_mode))
            self._give_to_owner(subfolder)

    def _give_to_owner(self, entry: Path) -> None:
        """Give a file written by root to the owner of the store."""
        if self._folder is not None and os.geteuid() == 0:
            owner = self._folder.stat()
            os.lchown(entry, owner.st_uid, owner.st_gid)

    def _sync(self, key: str) -> None:
        """Sync a local file to disk, and the two folders above it, to survive a power cut."""
        if self._folder is None:
            return
        path = self._folder / key
        self._give_to_owner(path)
        for entry in (path, path.parent, self._folder):
            descriptor = os.open(entry, os.O_RDONLY)
            try:
                os.fsync(descriptor)
            finally:
                os.close(descriptor)


def _key(digest: str) -> str:
    match = _DIGEST.fullmatch(digest)
    if match is None:
        raise NotFound("file", digest)
    name = match.group(1)
    return f"{name[:2]}/{name}"


def seems_unmounted(session: Session, files: FileStore) -> bool:
    """Whether the upload folder is unexpectedly empty, as if its volume were not mounted."""
    return files.is_empty() and session.scalar(select(Submission.id).limit(1)) is not None


_SWEEP_LOCK = 0x45447377  # any constant: shared by uploads, exclusive for a sweep (PostgreSQL)


def is_kept(session: Session, files: FileStore, file_digest: str) -> bool:
    """Whether a just stored file is still there; it then stays until this transaction ends.

    A sweep may have removed it as an orphan before its first record was written. SQLite has one
    write transaction at a time, so no lock is needed there.
    """
    lock_store(session, alone=False)
    return files.holds(file_digest)


def lock_store(session: Session, *, alone: bool) -> None:
    """Exclude sweeps until the transaction ends; with `alone`, uploads too. SQLite has one writer."""
    session.connection()  # begins the transaction: on SQLite that is the lock
    if session.get_bind().dialect.name == "postgresql":
        function = "pg_advisory_xact_lock" + ("" if alone else "_shared")
        session.execute(text(f"SELECT {function}(:key)"), {"key": _SWEEP_LOCK})
