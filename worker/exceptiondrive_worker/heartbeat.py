"""Heartbeats of worker processes, for readers and for health checks."""

import os
import socket
import threading
from collections.abc import Callable, Iterable

import structlog
from sqlalchemy import func, select
from sqlalchemy.exc import SQLAlchemyError

from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.database import Database, reason_of
from exceptiondrive_records.db.identifiers import random_id
from exceptiondrive_records.phases.phases import splits_in_use
from exceptiondrive_records.work.heartbeats import beat, forget_worker
from exceptiondrive_records.work.tables import WorkerHeartbeat
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_scoring import SCORER_VERSION

_log = structlog.get_logger("exceptiondrive.worker")


class Heartbeat:
    """Records every few seconds that this process is alive, until its parent is gone."""

    def __init__(
        self,
        database: Database,
        lanes: tuple[Lane, ...],
        every_s: float,
        ttl_s: float,
        missing: Callable[[Iterable[str]], list[str]] = lambda names: [],
    ) -> None:
        self.worker_id = f"{socket.gethostname()}:{os.getpid()}:{random_id(8)}"
        self._database = database
        self._lanes = lanes
        self._every_s = every_s
        self._ttl_s = ttl_s
        self._missing = missing
        self._parent = os.getppid()
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="heartbeat", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def stop(self) -> None:
        """End cleanly: the worker leaves the list at once."""
        self._stopped.set()
        self._thread.join(timeout=5)
        try:
            with self._database.write() as session:
                forget_worker(session, self.worker_id)
        except SQLAlchemyError as error:
            _log.warning("worker could not sign off", error=type(error).__name__)

    def _run(self) -> None:
        while os.getppid() == self._parent:
            try:
                with self._database.read() as session:
                    missing = self._missing(splits_in_use(session))
                with self._database.write() as session:
                    beat(
                        session,
                        self.worker_id,
                        self._lanes,
                        scorer_version=SCORER_VERSION,
                        missing_splits=missing,
                        ttl_s=self._ttl_s,
                    )
            except (SQLAlchemyError, OSError) as error:  # the folder of splits may be unavailable
                _log.warning(
                    "heartbeat not recorded", error=type(error).__name__, **reason_of(error)
                )
            if self._stopped.wait(self._every_s):
                return


def youngest_heartbeat_age_s(database: Database) -> float | None:
    """Return the age of the newest heartbeat of a worker on this machine; None if there is none."""
    with database.read() as session:
        of_this_machine = WorkerHeartbeat.worker_id.startswith(f"{socket.gethostname()}:")
        latest = session.scalar(select(func.max(WorkerHeartbeat.at)).where(of_this_machine))
        if latest is None:
            return None
        return (database_now(session) - latest).total_seconds()
