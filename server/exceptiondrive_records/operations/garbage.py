"""Garbage: stored files that no record mentions, left by refused uploads, unasked words and crashes.

What a refused upload left goes at once, what a crash left when it is old, what its team did not
confirm once the time for that has passed. The hard case is an upload
of the same bytes at the same moment: it finds the file stored, and its record is not written yet.
`file_store.is_kept` proves inside the transaction of the upload that the file is there, or has it
stored again, under a lock that no removal can hold meanwhile; and storing a file makes it young.
"""

import threading
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from sqlalchemy.exc import SQLAlchemyError

from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.db.errors import StoreError
from exceptiondrive_records.db.identifiers import random_id
from exceptiondrive_records.operations.dump import file_digests
from exceptiondrive_records.submissions.file_store import FileStore, lock_store
from exceptiondrive_records.work.lease import take_lead

GRACE = timedelta(hours=24)
"""An orphan that is younger may still belong to an upload under way."""
SWEEP_EVERY_S = 6 * 3600.0
_LOOK_EVERY_S = 60.0


@dataclass(frozen=True)
class Swept:
    """What a sweep removed."""

    n_files: int
    n_bytes: int


def sweep_orphans(
    database: Database, files: FileStore, *, actor: str, grace: timedelta = GRACE
) -> Swept:
    """Remove all stored files that are older than `grace` and that no record mentions.

    Raises:
        StoreError: The store did not answer; what was removed until then is right.
    """
    before = datetime.now(UTC) - grace
    with database.read() as session:
        mentioned = set(file_digests(session))
    candidates = [
        file for file in files.stored() if file.digest not in mentioned and file.changed_at < before
    ]
    removed = [
        file for file in candidates if remove_orphan(database, files, file.digest, before=before)
    ]
    swept = Swept(len(removed), sum(file.size_bytes for file in removed))
    if removed:
        with database.write() as session:
            audit(session, actor, "orphaned files swept", "file store", vars(swept))
    return swept


def remove_orphan(
    database: Database, files: FileStore, digest: str, *, before: datetime | None = None
) -> bool:
    """Remove a file that no record mentions, under the lock that an upload's transaction holds.

    It stays if it was sent after `before`, which is None where its upload was refused.

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


def run_sweeper(
    database: Database, files: FileStore, stop: threading.Event, every_s: float = SWEEP_EVERY_S
) -> None:
    """Sweep every few hours until `stop` is set; of all reconcilers one at a time."""
    from structlog import get_logger  # an operator's command has no log

    log = get_logger("exceptiondrive.reconciler")
    while not stop.is_set():
        try:
            with database.write() as session:
                is_due = take_lead(session, "sweep", random_id(), every_s)
            if is_due:
                swept = sweep_orphans(database, files, actor="reconciler")
                log.info("orphaned files swept", **vars(swept))
        except (SQLAlchemyError, StoreError) as error:
            log.warning("orphaned files not swept", error=type(error).__name__)
        stop.wait(min(every_s, _LOOK_EVERY_S))
