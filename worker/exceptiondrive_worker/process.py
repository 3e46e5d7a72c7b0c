"""The life of worker processes: doors, memory limit and heartbeat of each, after it has forked."""

import os
import threading
from collections.abc import Sequence
from typing import Any

import billiard.pool
import structlog
from celery import Celery
from celery.signals import worker_process_init, worker_process_shutdown

from exceptiondrive_records.db.identifiers import random_id
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_worker.app import create_app
from exceptiondrive_worker.doors import Doors, open_doors
from exceptiondrive_worker.heartbeat import Heartbeat
from exceptiondrive_worker.memory_limit import keep_memory, limit_memory
from exceptiondrive_worker.private_pruning import prune
from exceptiondrive_worker.settings import WorkerSettings
from exceptiondrive_worker.tasks import register_jobs

FAREWELL_TENTHS_S = 10
"""How long a process that ends waits for its parent to have heard of its last job. By default it
is 30 s, and on a stop in a busy moment the parent sometimes never says so. The records know every
outcome already, so that nothing is lost."""
BACKGROUND_NICENESS = 10
"""Of a worker that serves no live lane: on a full machine its processes give way to all others."""

_log = structlog.get_logger("exceptiondrive.worker")


class WorkerProcess:
    """What one forked process holds. Connections are never shared with its parent."""

    def __init__(self, settings: WorkerSettings, lanes: tuple[Lane, ...]) -> None:
        self._settings = settings
        self._lanes = lanes
        self._doors: Doors | None = None
        self._heartbeat: Heartbeat | None = None

    def begin(self, **_: Any) -> None:
        """Open the doors, start the heartbeat, then see to memory."""
        self._doors = open_doors(self._settings, self._lanes)
        self._heartbeat = Heartbeat(
            self._doors.database, self._lanes, self._settings.heartbeat_every_s
        )
        self._heartbeat.start()
        threading.Thread(target=self._prune, name="prune", daemon=True).start()
        keep_memory()
        limit_memory(self._settings.memory_headroom_bytes)

    def _prune(self) -> None:
        """Once in the life of a process, that is every hundred jobs or so."""
        settings = self._settings
        try:
            prune(
                self.doors().private,
                max_bytes=settings.private_max_bytes,
                max_age_days=settings.private_max_age_days,
            )
        except OSError as error:
            _log.warning("private store not pruned", error=type(error).__name__)

    def end(self, **_: Any) -> None:
        """Sign off and close the doors."""
        if self._heartbeat is not None:
            self._heartbeat.stop()
        if self._doors is not None:
            self._doors.close()

    def doors(self) -> Doors:
        """Return the open doors of this process."""
        if self._doors is None:
            raise RuntimeError("the worker process has not begun")
        return self._doors


def worker_app(settings: WorkerSettings, process: WorkerProcess) -> Celery:
    """Return the app with its jobs, and let every forked process begin and end as it should."""
    app = create_app(settings)
    register_jobs(app, process.doors)
    worker_process_init.connect(process.begin, weak=False)
    worker_process_shutdown.connect(process.end, weak=False)
    return app


def give_way(lanes: Sequence[Lane]) -> None:
    """Lower the priority of this process and its children if it works in the background alone."""
    if Lane.LIVE not in lanes:
        os.nice(BACKGROUND_NICENESS)


def run_worker(settings: WorkerSettings, lanes: Sequence[Lane], concurrency: int) -> None:
    """Work until told to stop."""
    billiard.pool.GUARANTEE_MESSAGE_CONSUMPTION_RETRY_LIMIT = FAREWELL_TENTHS_S
    give_way(lanes)
    process = WorkerProcess(settings, tuple(lanes))
    app = worker_app(settings, process)
    queues = ",".join(lane.value for lane in lanes)
    _log.info("worker starts", lanes=queues, processes=concurrency)
    app.worker_main(
        [
            "--quiet",
            "worker",
            f"--queues={queues}",
            f"--concurrency={concurrency}",
            "--pool=prefork",
            f"--hostname=worker-{random_id(8)}@%h",
            "--loglevel=WARNING",
            "--without-gossip",
            "--without-mingle",
            "--without-heartbeat",
        ]
    )
