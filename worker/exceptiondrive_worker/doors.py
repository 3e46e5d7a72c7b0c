"""The doors of a worker process: everything outside it that a job may touch."""

from collections.abc import Collection
from dataclasses import dataclass

from exceptiondrive_records.db.database import Database
from exceptiondrive_records.submissions.file_store import FileStore
from exceptiondrive_records.work.doorbell import Doorbell
from exceptiondrive_schemas.challenges import Challenge
from exceptiondrive_schemas.faults import CheckReport
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_schemas.protocol import Protocol
from exceptiondrive_schemas.split import Manifest
from exceptiondrive_scoring.aliases import Columns
from exceptiondrive_worker.private_store import PrivateStore
from exceptiondrive_worker.settings import WorkerSettings
from exceptiondrive_worker.split_store import SplitStore
from exceptiondrive_worker.stages import Stages
from exceptiondrive_worker.upload_reader import read_upload


@dataclass(frozen=True)
class Doors:
    """Opened once per process, after it has forked."""

    settings: WorkerSettings
    database: Database
    files: FileStore
    splits: SplitStore
    private: PrivateStore
    doorbell: Doorbell
    stages: Stages
    serves_live: bool = True
    """Whether live jobs may wait for this process."""

    def close(self) -> None:
        """Close all connections."""
        self.doorbell.close()
        self.database.dispose()


def open_doors(settings: WorkerSettings, lanes: Collection[Lane] = tuple(Lane)) -> Doors:
    """Open all doors that the settings name, for a process that serves these lanes."""
    files = FileStore(settings.file_store_url)
    private = PrivateStore(settings.private_dir)
    return Doors(
        settings=settings,
        database=Database(settings.database_url),
        files=files,
        splits=SplitStore(settings.splits_dir),
        private=private,
        doorbell=Doorbell(settings.broker_url),
        stages=stages_over(settings, files, private),
        serves_live=Lane.LIVE in lanes,
    )


def stages_over(settings: WorkerSettings, files: FileStore, private: PrivateStore) -> Stages:
    """Return the stages that keep their results in this private store."""

    def load_upload(digest: str) -> bytes:
        return files.read(digest, limit_bytes=settings.max_upload_bytes)

    def read_answers(
        data: bytes, challenge: Challenge, manifest: Manifest, protocol: Protocol
    ) -> Columns | CheckReport:
        return read_upload(
            data,
            challenge=challenge,
            manifest=manifest,
            protocol=protocol,
            max_upload_bytes=settings.max_upload_bytes,
            max_inflated_bytes=settings.max_inflated_bytes,
        )

    return Stages(private, load_upload, read_answers)
