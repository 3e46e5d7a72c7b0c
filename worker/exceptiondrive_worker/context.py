"""The context of a worker process: all external resources that its work may use."""

from collections.abc import Collection
from dataclasses import dataclass
from functools import partial

from exceptiondrive_records.db.database import Database
from exceptiondrive_records.submissions.file_store import FileStore
from exceptiondrive_records.work.dispatch import Dispatcher
from exceptiondrive_records.work.lease import Item, claim_oldest
from exceptiondrive_schemas.check import MAX_INFLATED_BYTES
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_worker.settings import WorkerSettings
from exceptiondrive_worker.splits.private_store import PrivateStore
from exceptiondrive_worker.splits.store import SplitStore
from exceptiondrive_worker.stages import Stages
from exceptiondrive_worker.upload_reader import read_upload


@dataclass(frozen=True)
class WorkerContext:
    """Opened once per process, after it has forked."""

    settings: WorkerSettings
    database: Database
    files: FileStore
    splits: SplitStore
    private: PrivateStore
    dispatcher: Dispatcher
    stages: Stages
    lanes: frozenset[Lane] = frozenset(Lane)
    """The lanes that this process serves."""

    def claim_oldest(self, kind: type[Item]) -> Item | None:
        """Lease the oldest request of a kind; None if there is none."""
        with self.database.claim() as session:
            return claim_oldest(session, kind, self.settings.lease_s, self.settings.max_attempts)

    def close(self) -> None:
        """Close all connections."""
        self.dispatcher.close()
        self.database.dispose()


def open_context(
    settings: WorkerSettings, lanes: Collection[Lane] = frozenset(Lane)
) -> WorkerContext:
    """Connect to everything that the settings name, for a process that serves these lanes."""
    files = FileStore(settings.file_store_url)
    private = PrivateStore(settings.private_dir)
    return WorkerContext(
        settings=settings,
        database=Database(settings.database_url),
        files=files,
        splits=SplitStore(settings.splits_dir),
        private=private,
        dispatcher=Dispatcher(settings.broker_url),
        stages=stages_over(files, private),
        lanes=frozenset(lanes),
    )


def stages_over(files: FileStore, private: PrivateStore) -> Stages:
    """Return the stages that cache their results in this private store."""
    return Stages(private, partial(files.read, limit_bytes=MAX_INFLATED_BYTES), read_upload)
