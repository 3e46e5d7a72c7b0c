"""The life of worker processes: context, memory limit and heartbeat of each, after it has forked."""

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
"""How long a process that ends waits for its parent to have heard of its last job. By default it
is 30 s, and on a stop in a busy moment the parent sometimes never says so. The records know every
outcome already, so that nothing is lost."""
BACKGROUND_NICENESS = 10
"""Of a worker that serves no live lane: on a full machine its processes give way to all others."""
KEEP_BYTES = 24 * 2**20
_STATM = Path("/proc/self/statm")

_log = structlog.get_logger("exceptiondrive.worker")


class WorkerProcess:
    """What one forked process holds. Connections are never shared with its parent."""

    def __init__(self, settings: WorkerSettings, lanes: tuple[Lane, ...]) -> None:
        self._settings = settings
        self._lanes = lanes
        self._context: WorkerContext | None = None
        self._heartbeat: Heartbeat | None = None

    def begin(self, **_: Any) -> None:
        """Open the context, start the heartbeat, then see to memory.

        Where a folder is away or cannot be written the log says so, and the next message tries again.
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
        """Once in the life of a process, that is every hundred messages or so."""
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
    """Give the app what the broker may call by name; `context` is that of the calling process.

    Where nothing could be recorded the lease runs out, and the reconciler wakes another worker.
    """

    @app.task(name=JobName.WAKE.value)
    def wake(lane: str) -> None:
        run_job(lane, lambda: work(context(), Lane(lane)), lambda _: None)


def worker_app(settings: WorkerSettings, process: WorkerProcess) -> Celery:
    """Return the app with its tasks, and let every forked process begin and end as it should."""
    app = create_app(settings)
    register_tasks(app, process.context)
    worker_process_init.connect(process.begin, weak=False)
    worker_process_shutdown.connect(process.end, weak=False)
    return app


def give_way(lanes: Sequence[Lane]) -> None:
    """Lower the priority of this process and its children if it works in the background alone."""
    if Lane.LIVE not in lanes:
        os.nice(BACKGROUND_NICENESS)


def run_worker(settings: WorkerSettings, lanes: Sequence[Lane], concurrency: int) -> None:
    """Work until told to stop, and leave with the exit code of the worker.

    It is made here: Celery's command line would import all of its commands, a shell of them too.
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
    """Return how much address space this process has now; None where the system does not say."""
    try:
        pages = int(_STATM.read_text().split()[0])
    except (FileNotFoundError, PermissionError):
        return None
    return pages * resource.getpagesize()


def keep_memory() -> None:
    """Free one large block that nobody has touched: scoring then takes up to half the time.

    glibc hands freed memory back to the system above a threshold, and pays for every page again at
    the next temporary; the threshold follows the largest block that was freed. What a process holds
    by now it holds to its end: the collector of cycles looks at it no more.
    """
    np.empty(KEEP_BYTES, dtype=np.uint8)
    gc.freeze()


def limit_memory(headroom_bytes: int) -> None:
    """Let this process take at most so much beyond what it has.

    Allocations beyond it raise `MemoryError`. Without `/proc` nothing is limited.
    """
    present = address_space_bytes()
    if present is None:
        return
    limit = present + headroom_bytes
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    if hard != resource.RLIM_INFINITY:
        limit = min(limit, hard)
    resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
