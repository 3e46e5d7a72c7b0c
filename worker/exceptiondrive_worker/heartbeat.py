"""Signs of life of one worker process, from a thread of its own."""

import os
import socket
import threading

import structlog
from sqlalchemy.exc import SQLAlchemyError

from exceptiondrive_records.database import Database
from exceptiondrive_records.heartbeats import beat, forget_worker
from exceptiondrive_records.identifiers import random_id
from exceptiondrive_schemas.jobs import Lane

_log = structlog.get_logger("exceptiondrive.worker")


class Heartbeat:
    """Records every few seconds that this process lives, until its parent is gone."""

    def __init__(self, database: Database, lanes: tuple[Lane, ...], every_s: float) -> None:
        self.worker_id = f"{socket.gethostname()}:{os.getpid()}:{random_id(8)}"
        self._database = database
        self._lanes = lanes
        self._every_s = every_s
        self._parent = os.getppid()
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="heartbeat", daemon=True)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def stop(self) -> None:
        """End in good order: the worker leaves the list at once."""
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
                with self._database.write() as session:
                    beat(session, self.worker_id, self._lanes, slots=1)
            except SQLAlchemyError as error:
                _log.warning("heartbeat not recorded", error=type(error).__name__)
            if self._stopped.wait(self._every_s):
                return
