"""The life of worker processes: context, memory limit and heartbeat of each, after it has forked."""

import gc
import logging
import os
import resource
import socket
import sys
import threading
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import billiard.pool
import numpy as np
import structlog
from celery import Celery
from celery.signals import worker_process_init, worker_process_shutdown
from sqlalchemy import func, select
from sqlalchemy.exc import SQLAlchemyError
from structlog.typing import Processor

from exceptiondrive_records.db.database import Database, database_now
from exceptiondrive_records.db.identifiers import random_id
from exceptiondrive_records.phases.phases import splits_in_use
from exceptiondrive_records.work.heartbeats import beat, forget_worker
from exceptiondrive_records.work.tables import WorkerHeartbeat
from exceptiondrive_schemas.jobs import JobName, Lane
from exceptiondrive_scoring import SCORER_VERSION
from exceptiondrive_worker.app import create_app
from exceptiondrive_worker.context import WorkerContext, open_context
from exceptiondrive_worker.failures import job_boundary
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
        """Open the context, start the heartbeat, then see to memory."""
        self._context = open_context(self._settings, self._lanes)
        self._heartbeat = Heartbeat(
            self._context.database,
            self._lanes,
            self._settings.heartbeat_every_s,
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
            raise RuntimeError("the worker process has not begun")
        return self._context


def register_tasks(app: Celery, context: Callable[[], WorkerContext]) -> None:
    """Give the app what the broker may call by name; `context` is that of the calling process.

    Where nothing could be recorded the lease runs out, and the reconciler wakes another worker.
    """

    @app.task(name=JobName.WAKE.value)
    def wake(lane: str) -> None:
        with job_boundary(lane, lambda _: None):
            work(context(), Lane(lane))


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


class Heartbeat:
    """Records every few seconds that this process lives, until its parent is gone."""

    def __init__(
        self,
        database: Database,
        lanes: tuple[Lane, ...],
        every_s: float,
        missing: Callable[[Iterable[str]], list[str]] = lambda names: [],
    ) -> None:
        self.worker_id = f"{socket.gethostname()}:{os.getpid()}:{random_id(8)}"
        self._database = database
        self._lanes = lanes
        self._every_s = every_s
        self._missing = missing
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
                with self._database.read() as session:
                    missing = self._missing(splits_in_use(session))
                with self._database.write() as session:
                    beat(session, self.worker_id, self._lanes, 1, SCORER_VERSION, missing)
            except SQLAlchemyError as error:
                _log.warning("heartbeat not recorded", error=type(error).__name__)
            if self._stopped.wait(self._every_s):
                return


def youngest_heartbeat_age_s(database: Database) -> float | None:
    """Return how long ago a worker on this machine last gave a sign of life; None if never."""
    with database.read() as session:
        of_this_machine = WorkerHeartbeat.worker_id.startswith(f"{socket.gethostname()}:")
        latest = session.scalar(select(func.max(WorkerHeartbeat.at)).where(of_this_machine))
        if latest is None:
            return None
        return (database_now(session) - latest).total_seconds()


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


def limit_memory(headroom_bytes: int) -> int | None:
    """Let this process take at most so much beyond what it has; return the limit in bytes.

    Allocations beyond it raise `MemoryError`. Without `/proc` nothing is limited: None.
    """
    present = address_space_bytes()
    if present is None:
        return None
    limit = present + headroom_bytes
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    if hard != resource.RLIM_INFINITY:
        limit = min(limit, hard)
    resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
    return limit


def configure_logging() -> None:
    """Send all log lines of this process, libraries and warnings included, the same way."""
    shared: list[Processor] = [
        structlog.processors.add_log_level,
        structlog.processors.TimeStamper(fmt="iso", utc=True),
        structlog.processors.format_exc_info,
    ]
    renderer: Processor = structlog.processors.JSONRenderer()
    if sys.stderr.isatty():
        renderer = structlog.dev.ConsoleRenderer()
    structlog.configure(
        processors=[*shared, renderer], logger_factory=structlog.PrintLoggerFactory(sys.stderr)
    )
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(
        structlog.stdlib.ProcessorFormatter(
            foreign_pre_chain=shared,
            processors=[structlog.stdlib.ProcessorFormatter.remove_processors_meta, renderer],
        )
    )
    logging.basicConfig(level=logging.WARNING, handlers=[handler], force=True)
    logging.captureWarnings(capture=True)
