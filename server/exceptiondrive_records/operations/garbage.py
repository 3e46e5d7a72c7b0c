"""Collect garbage: stored files that no record mentions.

The file of a refused upload is removed at once, that of an unconfirmed upload after its time to
confirm, and a file left by a crash when it is old. The hard case is a concurrent upload of the same
bytes, which finds the file stored before its own record is written. So `file_store.is_kept` checks
inside the upload's transaction, under a lock that excludes removal, that the file is there, or
stores it again; storing a file also renews its age.

With a database that is empty or older than the uploads, all files look like garbage. So only an
operator's command removes more files than a crash could leave.
"""

import math
import threading
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import Session

from exceptiondrive_records.audit.log import audit, last_action
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.db.errors import RecordsError, StoreError
from exceptiondrive_records.db.identifiers import random_id
from exceptiondrive_records.operations.dump import file_digests
from exceptiondrive_records.submissions.file_store import FileStore, lock_store
from exceptiondrive_records.work.lease import take_lead

GRACE = timedelta(hours=24)
"""A younger orphan may still belong to an upload in progress."""
SWEEP_EVERY_S = 6 * 3600.0
_POLL_EVERY_S = 60.0
_BY_ITSELF = 3
"""Crashes leave at most so many files without a record."""
_UNDER_WAY = timedelta(hours=1)
"""A younger file may belong to an upload whose record is being written."""
_SUBJECT, _SWEPT, _LEFT = "file store", "orphaned files swept", "orphaned files left"


@dataclass(frozen=True)
class Swept:
    """What a sweep removed."""

    n_files: int
    n_bytes: int


class UnknownFiles(RecordsError):  # noqa: N818
    """More files have no record than crashes leave; none was removed."""

    def __init__(self, n_files: int) -> None:
        super().__init__(f"{n_files} stored files are in no record.")
        self.n_files = n_files


def sweep_orphans(
    database: Database,
    files: FileStore,
    *,
    actor: str,
    grace: timedelta = GRACE,
    at_most: float = math.inf,
) -> Swept:
    """Remove all stored files that are older than `grace` and that no record mentions.

    Raises:
        UnknownFiles: More than `at_most` files have no record at all, not even an unconfirmed one.
            The audit log notes this once.
        StoreError: The store did not answer; files removed until then were orphans.
    """
    now = datetime.now(UTC)
    with database.read() as session:
        mentioned = set(file_digests(session))
        known = set(file_digests(session, with_unconfirmed=True))
        were_left = orphans_were_left(session)
    orphans = [file for file in files.stored() if file.digest not in mentioned]
    n_unknown = sum(
        file.digest not in known and file.changed_at < now - _UNDER_WAY for file in orphans
    )
    if n_unknown > at_most:
        if not were_left:
            with database.write() as session:
                audit(session, actor, _LEFT, _SUBJECT, {"n_files": n_unknown})
        raise UnknownFiles(n_unknown)
    before = now - grace
    removed = [
        file
        for file in orphans
        if file.changed_at < before and remove_orphan(database, files, file.digest, before=before)
    ]
    swept = Swept(len(removed), sum(file.size_bytes for file in removed))
    if removed or were_left:
        with database.write() as session:
            audit(session, actor, _SWEPT, _SUBJECT, vars(swept))
    return swept


def orphans_were_left(session: Session) -> bool:
    """Whether the last sweep removed nothing, as more files had no record than crashes leave."""
    return last_action(session, _SUBJECT, _SWEPT, _LEFT) == _LEFT


def remove_orphan(
    database: Database, files: FileStore, digest: str, *, before: datetime | None = None
) -> bool:
    """Remove a file that no record mentions, under the lock that an upload's transaction holds.

    It stays if it was stored at or after `before`; `before` is None for a refused upload.

    Returns:
        Whether it was removed.

    Raises:
        StoreError: The store did not answer.
    """
    with database.write() as session:
        lock_store(session, alone=True)
        changed_at = files.changed_at(digest)
        is_young = before is not None and changed_at is not None and changed_at >= before
        if changed_at is None or is_young or file_digests(session, digest):
            return False
        files.remove(digest)
        return True


def run_sweeper(database: Database, files: FileStore, stop: threading.Event) -> None:
    """Sweep what crashes left every few hours, in one reconciler at a time, until `stop` is set."""
    from structlog import get_logger  # operators' commands do not log

    log = get_logger("exceptiondrive.reconciler")
    while not stop.is_set():
        try:
            with database.write() as session:
                is_due = take_lead(session, "sweep", random_id(), SWEEP_EVERY_S)
            if is_due:
                swept = sweep_orphans(database, files, actor="reconciler", at_most=_BY_ITSELF)
                log.info(_SWEPT, **vars(swept))
        except UnknownFiles as found:
            log.warning(_LEFT, n_files=found.n_files)
        except (SQLAlchemyError, StoreError) as error:
            log.warning("orphaned files not swept", error=type(error).__name__)
        stop.wait(_POLL_EVERY_S)
