"""Backup and restore: one file with every row and every upload, for any database and file store.

It holds nothing withheld: splits stay with the workers, and the workers' private store is rebuilt
from uploads and splits.
"""

import gzip
import io
import json
import os
import tarfile
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import IO, Literal

from pydantic import Field
from sqlalchemy import Table
from sqlalchemy.orm import Session

from exceptiondrive_records.audit.log import verify_audit
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.db.errors import NotFound, RecordsError, StoreError
from exceptiondrive_records.migrations import migrate, newest_revision
from exceptiondrive_records.operations.dump import (
    begin_snapshot,
    column_names,
    dump_rows,
    dumped_tables,
    file_digests,
    is_empty,
    load_rows,
)
from exceptiondrive_records.operations.invariants import violations
from exceptiondrive_records.submissions.file_store import FileDamaged, FileStore, FileUnreadable
from exceptiondrive_schemas.base import Document

LIMIT_BYTES = 2**30
_LEVEL = 4
"""Of rows; uploads are packed already."""
_HEAD = "backup.json"


class BackupHead(Document):
    """What a backup says of itself; its first member."""

    format: Literal["exceptiondrive.backup/2"]
    created_at: str
    schema_revision: str
    columns: dict[str, list[str]]
    audit_lines: int
    audit_head: str
    n_files: int
    without: list[str] = Field(default_factory=list)
    """Digests of the uploads that were lost when it was written: missing, damaged or unreadable."""


class BackupError(RecordsError):
    """The backup cannot be written or restored; the text says what to do."""


def write_backup(
    database: Database, files: FileStore, path: Path, *, without_lost: bool = False
) -> BackupHead:
    """Write a backup of one moment; the file appears when it is whole, readable by its owner.

    Raises:
        BackupError: An upload is missing or damaged, and not left out by `without_lost`, the store is
            away, or the file cannot be written.
    """
    try:
        with _atomic_file(path) as stream, tarfile.open(fileobj=stream, mode="w|") as archive:
            with database.read() as session:
                begin_snapshot(session)
                digests = file_digests(session)
                lost = [each for each in digests if without_lost and _is_lost(files, each)]
                kept = [each for each in digests if each not in lost]
                head = _head(session, len(kept), lost)
                _add(archive, _HEAD, head.model_dump_json(indent=1).encode())
                for table in dumped_tables():
                    rows = dump_rows(session, table)
                    _add_lines(archive, _member(table), rows, path.parent)
            for digest in kept:  # files never change: they need no snapshot
                data = files.read(digest, limit_bytes=LIMIT_BYTES)
                _add(archive, f"files/{digest.removeprefix('sha256:')}", data)
    except (NotFound, FileDamaged, FileUnreadable) as error:
        raise BackupError(
            f"{error} No backup was written. exceptiondrive-server verify says whose file it is; see "
            "`broken invariants` in docs/operating.md. Until it is back: exceptiondrive-server backup "
            "--without-lost"
        ) from None
    except StoreError as error:
        raise BackupError(
            f"{error} No backup was written. exceptiondrive-server doctor says more."
        ) from None
    except OSError as error:
        raise BackupError(f"{path} cannot be written: {error.strerror}") from None
    return head


def restore_backup(path: Path, database_url: str, files: FileStore) -> BackupHead:
    """Restore into empty records, then check every invariant; all of it is kept, or no row.

    Raises:
        BackupError: Not a complete backup, of another schema, or the records are not empty.
    """
    try:
        with tarfile.open(path, mode="r:") as archive:
            head = _read_head(archive)
            migrate(database_url)
            database = Database(database_url)
            try:
                with database.read() as session:  # before a file is put anywhere
                    _require_empty(session)
                _restore_files(archive, files, head)  # rows come last: none without its file
                with database.write() as session:
                    _restore_rows(archive, session, head)
            finally:
                database.dispose()
    except StoreError as error:
        raise BackupError(
            f"{error} No row was restored. This user needs space, and permission to write, where "
            "EXCEPTIONDRIVE_FILE_STORE_URL says: name a new folder, since an old one belongs to another user."
        ) from None
    except (tarfile.TarError, KeyError, EOFError, zlib.error, gzip.BadGzipFile) as error:
        # KeyError: a table is missing
        raise BackupError(f"{path} is not a complete backup: {error}") from None
    except OSError as error:
        raise BackupError(f"{path} cannot be restored: {error.strerror or error}") from None
    return head


def _is_lost(files: FileStore, digest: str) -> bool:
    """Raises StoreError where the whole store is away."""
    try:
        files.read(digest, limit_bytes=LIMIT_BYTES)
    except (NotFound, FileDamaged, FileUnreadable):
        return True
    return False


def _head(session: Session, n_files: int, without: list[str]) -> BackupHead:
    verdict = verify_audit(session)
    if not verdict.is_whole:
        raise BackupError(
            f"the audit chain breaks at line {verdict.broken_at}: these records "
            "cannot be trusted; restore an earlier backup (docs/operating.md)"
        )
    return BackupHead(
        format="exceptiondrive.backup/2",
        created_at=database_now(session).isoformat(),
        schema_revision=newest_revision(),
        columns={table.name: column_names(table) for table in dumped_tables()},
        audit_lines=verdict.n_lines,
        audit_head=verdict.head,
        n_files=n_files,
        without=without,
    )


def _read_head(archive: tarfile.TarFile) -> BackupHead:
    member = archive.next()
    stream = None if member is None or member.name != _HEAD else archive.extractfile(member)
    if stream is None:
        raise BackupError("this is not a backup of exceptiondrive-server")
    try:
        document = json.load(stream)
        head = BackupHead.model_validate(document)
    except (ValueError, RecursionError):
        raise BackupError(
            "the head of the backup cannot be read; restore a backup of an earlier version with that version"
        ) from None
    if head.schema_revision != newest_revision():
        raise BackupError(
            f"the backup has schema {head.schema_revision}, this version has {newest_revision()}: "
            "restore it with the version that wrote it, then upgrade"
        )
    here = {table.name: column_names(table) for table in dumped_tables()}
    others = sorted(
        name
        for name in here.keys() | head.columns.keys()
        if here.get(name) != head.columns.get(name)
    )
    if others:
        raise BackupError(
            f"the backup has other columns of {', '.join(others)} than this version: "
            "restore it with the version that wrote it"
        )
    return head


def _restore_files(archive: tarfile.TarFile, files: FileStore, head: BackupHead) -> None:
    names = [name for name in archive.getnames() if name.startswith("files/")]
    if len(names) != head.n_files:
        raise BackupError(f"the backup holds {len(names)} files, not {head.n_files}: cut short?")
    for name in names:
        stream = archive.extractfile(name)
        assert stream is not None
        digest, _ = files.put_stream(
            iter(partial(stream.read, 2**20), b""), limit_bytes=LIMIT_BYTES
        )
        if digest != f"sha256:{name.removeprefix('files/')}":
            raise BackupError(f"{name} in the backup does not hold the bytes of its name")


def _require_empty(session: Session) -> None:
    if not is_empty(session):
        raise BackupError(
            "these records are not empty (on PostgreSQL, rights that `migrate --grant-to` gave are enough "
            "for that): restore into a new database and a new file store; see `restore` in docs/operating.md"
        )


def _restore_rows(archive: tarfile.TarFile, session: Session, head: BackupHead) -> None:
    _require_empty(session)
    for table in dumped_tables():
        stream = archive.extractfile(_member(table))
        assert stream is not None
        with gzip.open(stream, "rt", encoding="utf-8") as rows:
            load_rows(session, table, rows)
    session.flush()
    verdict = verify_audit(session)
    if (verdict.n_lines, verdict.head) != (head.audit_lines, head.audit_head):
        raise BackupError("the restored audit chain does not have the head that the backup names")
    broken = violations(session)
    if broken:
        lines = "\n".join(str(violation) for violation in broken[:20])
        raise BackupError(f"the backup breaks invariants:\n{lines}")


def _member(table: Table) -> str:
    return f"records/{table.name}.jsonl.gz"


def _add(archive: tarfile.TarFile, name: str, data: bytes) -> None:
    member = tarfile.TarInfo(name)
    member.size, member.mode = len(data), 0o600
    archive.addfile(member, io.BytesIO(data))


def _add_lines(archive: tarfile.TarFile, name: str, lines: Iterator[str], folder: Path) -> None:
    """Add a table, which lies in `folder` first: a container's /tmp is memory, and small."""
    with tempfile.TemporaryFile(dir=folder) as spooled:
        with gzip.open(spooled, "wt", _LEVEL, encoding="utf-8") as packed:
            packed.writelines(f"{line}\n" for line in lines)
        member = tarfile.TarInfo(name)
        member.size, member.mode = spooled.tell(), 0o600
        spooled.seek(0)
        archive.addfile(member, spooled)


@contextmanager
def _atomic_file(path: Path) -> Iterator[IO[bytes]]:
    """Open a file that is synced and renamed into place on success, and removed otherwise."""
    descriptor, name = tempfile.mkstemp(prefix=f".{path.name}-", dir=path.parent)
    try:
        with os.fdopen(descriptor, "wb") as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
