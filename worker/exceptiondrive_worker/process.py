"""The life cycle of worker processes: context, memory limit and heartbeat, set after the fork."""

import gc
import os
import resource
import socket
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import billiard.pool
import numpy as np
import structlog
from celery import Celery
from celery.signals import worker_process_init, worker_process_shutdown

from exceptiondrive_records.db.identifiers import random_id
from exceptiondrive_schemas.jobs import JobName, Lane
from exceptiondrive_worker.app import create_app
from exceptiondrive_worker.context import WorkerContext, open_context
from exceptiondrive_worker.failures import run_job
from exceptiondrive_worker.heartbeat import Heartbeat
from exceptiondrive_worker.settings import WorkerSettings
from exceptiondrive_worker.splits.private_store import prune
from exceptiondrive_worker.work import work

FAREWELL_TENTHS_S = 10
"""How long an ending process waits for its parent to acknowledge its last job. The default is 30 s,
and when stopped under load the parent sometimes never does. The records know every outcome
already, so nothing is lost."""
BACKGROUND_NICENESS = 10
"""Niceness of workers that serve no live lane: on a busy machine they yield to all others."""
KEEP_BYTES = 24 * 2**20
_STATM = Path("/proc/self/statm")

_log = structlog.get_logger("exceptiondrive.worker")


class WorkerProcess:
    """State of one forked process. Connections are never shared with its parent."""

    def __init__(self, settings: WorkerSettings, lanes: tuple[Lane, ...]) -> None:
        self._settings = settings
        self._lanes = lanes
        self._context: WorkerContext | None = None
        self._heartbeat: Heartbeat | None = None

    def begin(self, **_: Any) -> None:
        """Open the context, start the heartbeat, then set up memory.

        If a folder is missing or read-only, that is logged, and the next message tries again.
        """
        try:
            self._context = open_context(self._settings, self._lanes)
        except OSError as error:
            _log.error(
                "the process scores nothing until EXCEPTIONDRIVE_PRIVATE_DIR can be written and "
                "EXCEPTIONDRIVE_FILE_STORE_URL be reached",
                why=str(error),
            )
            return
        self._heartbeat = Heartbeat(
            self._context.database,
            self._lanes,
            self._settings.heartbeat_every_s,
            self._settings.heartbeat_ttl_s,
            self._context.splits.missing,
        )
        self._heartbeat.start()
        threading.Thread(target=self._prune, name="prune", daemon=True).start()
        keep_memory()
        limit_memory(self._settings.memory_headroom_bytes)

    def _prune(self) -> None:
        """Prune the private store once per process, that is, every hundred messages or so."""
        settings = self._settings
        try:
            prune(
                self.context().private,
                max_bytes=settings.private_max_bytes,
                max_age_days=settings.private_max_age_days,
            )
        except OSError as error:
            _log.warning("private store not pruned", error=type(error).__name__)

    def end(self, **_: Any) -> None:
        """Sign off and close the context."""
        if self._heartbeat is not None:
            self._heartbeat.stop()
        if self._context is not None:
            self._context.close()

    def context(self) -> WorkerContext:
        """Return the open context of this process."""
        if self._context is None:
            self.begin()
        if self._context is None:
            raise RuntimeError("the worker process has not begun")
        return self._context


def register_tasks(app: Celery, context: Callable[[], WorkerContext]) -> None:
    """Register the tasks that the broker may call; `context` returns that of the calling process.

    If nothing could be recorded, the lease expires, and the reconciler wakes another worker.
    """

    @app.task(name=JobName.WAKE.value)
    def wake(lane: str) -> None:
        run_job(lane, lambda: work(context(), Lane(lane)), lambda _: None)


def worker_app(settings: WorkerSettings, process: WorkerProcess) -> Celery:
    """Return the app with its tasks, and hook `process` into the start and end of every fork."""
    app = create_app(settings)
    register_tasks(app, process.context)
    worker_process_init.connect(process.begin, weak=False)
    worker_process_shutdown.connect(process.end, weak=False)
    return app


def give_way(lanes: Sequence[Lane]) -> None:
    """Lower the priority of this process and its children if it does background work only."""
    if Lane.LIVE not in lanes:
        os.nice(BACKGROUND_NICENESS)


def run_worker(settings: WorkerSettings, lanes: Sequence[Lane], concurrency: int) -> None:
    """Work until stopped, then exit with the exit code of the worker.

    Builds the worker itself: Celery's command line would import all its commands, even a shell.
    """
    billiard.pool.GUARANTEE_MESSAGE_CONSUMPTION_RETRY_LIMIT = FAREWELL_TENTHS_S
    give_way(lanes)
    process = WorkerProcess(settings, tuple(lanes))
    app = worker_app(settings, process)
    queues = [lane.value for lane in lanes]
    _log.info("worker starts", lanes=",".join(queues), processes=concurrency)
    worker = app.Worker(
        queues=queues,
        concurrency=concurrency,
        hostname=f"worker-{random_id(8)}@{socket.gethostname()}",
        loglevel="WARNING",
        quiet=True,
        without_gossip=True,
        without_mingle=True,
        without_heartbeat=True,
    )
    worker.start()
    raise SystemExit(worker.exitcode)


def address_space_bytes() -> int | None:
    """Return how much address space this process uses; None if the system does not report it."""
    try:
        pages = int(_STATM.read_text().split()[0])
    except (FileNotFoundError, PermissionError):
        return None
    return pages * resource.getpagesize()


def keep_memory() -> None:
    """Free one large untouched block: scoring then takes up to half the time.

    glibc returns freed memory above a threshold to the system, and the next temporary pays for
    every page again; the threshold grows to the largest block freed. Objects that exist now live
    until the process ends, so they are excluded from garbage collection.
    """
    np.empty(KEEP_BYTES, dtype=np.uint8)
    gc.freeze()


def limit_memory(headroom_bytes: int) -> None:
    """Limit this process to so much memory beyond its present use.

    Allocations beyond it raise `MemoryError`. Without `/proc` there is no limit.
    """
    present = address_space_bytes()
    if present is None:
        return
    limit = present + headroom_bytes
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    if hard != resource.RLIM_INFINITY:
        limit = min(limit, hard)
    resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
