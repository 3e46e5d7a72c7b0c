"""Real databases, a real file store and real splits; nothing is mocked."""

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.canary.values import CANARY_M
from tests.support import documents, processes
from tests.support.databases import as_role
from tests.support.documents import region_ahead, split_document
from tests.support.records import add_phase
from tests.support.worker import add_split, score_submission, submit, worker_settings
from tests.worker.real_broker import QUICK

from exceptiondrive_records.db.database import Database
from exceptiondrive_records.db.roles import Role
from exceptiondrive_records.operations.reconciler import run_reconciler as reconcile
from exceptiondrive_records.protocols.protocols import add_protocol
from exceptiondrive_records.submissions.file_store import FileStore
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.work.dispatch import Dispatcher
from exceptiondrive_records.work.tables import Job
from exceptiondrive_schemas.protocol import (
    ProtocolDocument,
    packaged_protocol,
    packaged_protocol_toml,
)
from exceptiondrive_schemas.split import Split
from exceptiondrive_worker.context import WorkerContext, open_context
from exceptiondrive_worker.settings import WorkerSettings


@pytest.fixture(scope="session")
def protocol() -> ProtocolDocument:
    return packaged_protocol()


@pytest.fixture(scope="session")
def make_split() -> Callable[..., Split]:
    """Make a split of samples given as `{sample_id: changes}`; regions lie ahead by default."""

    usual = {"region": region_ahead(10.0, CANARY_M)}
    return lambda samples, name="tiny": split_document(
        {key: usual | changes for key, changes in samples.items()}, name
    )


@pytest.fixture(scope="session")
def tiny(make_split: Callable[..., Split]) -> Split:
    """Four samples in two scenes and three families, every region 10 m ahead."""
    return make_split(
        {
            "a": {},
            "b": {"task": "LB1"},
            "c": {"task": "LB1", "scene_id": "scene-2"},
            "d": {"task": "RS1", "scene_id": "scene-2"},
        }
    )


@pytest.fixture(scope="session")
def planning_file() -> Callable[..., bytes]:
    """Make a planning file: everybody drives straight ahead at a speed, `changes` by sample."""

    def make(
        split: Split,
        edited_mps: float = 1.0,
        source_mps: float = 4.0,
        changes: dict[str, dict[str, Any]] | None = None,
    ) -> bytes:
        speeds_mps = {sample.sample_id: edited_mps for sample in split.samples}
        return documents.planning_file(
            speeds_mps, source_mps=source_mps, changes=changes, split=split.name
        )

    return make


class World:
    """Records, files and splits of one test, and the context of a worker.

    On PostgreSQL the worker has its own role, and `database` is the owner's.
    """

    def __init__(self, settings: WorkerSettings) -> None:
        role_url = as_role(settings.database_url, Role.WORKER)
        self.settings = settings.model_copy(update={"database_url": role_url})
        self.database = Database(settings.database_url)
        self.files = FileStore(settings.file_store_url)
        self._context: WorkerContext | None = None

    @property
    def context(self) -> WorkerContext:
        if self._context is None:
            self._context = open_context(self.settings)
        return self._context

    def reopen_context(self) -> None:
        """As a new worker process would: nothing is remembered but what is stored."""
        self.close_context()
        self._context = None

    def add_split(self, split: Split) -> None:
        add_split(self.database, self.settings.splits_dir, split)

    def add_phase(self, split: Split, phase_id: str = "dev", **options: Any) -> None:
        self.add_split(split)
        with self.database.write() as session:
            add_protocol(session, packaged_protocol_toml(), "test")
            add_phase(
                session,
                phase_id,
                split=split.name,
                **{"quota_per_day": 1000, "rejected_per_day": 1000, **options},
            )

    def submit(self, data: bytes, method: str = "method", **more: Any) -> tuple[str, str]:
        """Accept an upload as the server does; return ids of submission and job."""
        accepted = submit(self.database, self.files, data, method=method, **more)
        assert accepted.job_id is not None
        return accepted.submission.id, accepted.job_id

    def score(self, data: bytes, **where: Any) -> str:
        """Submit and score in this process; return the id of the submission."""
        submission_id, job_id = self.submit(data, **where)
        score_submission(self.context, job_id)
        return submission_id

    def submission(self, submission_id: str) -> Submission:
        with self.database.read() as session:
            return session.get_one(Submission, submission_id)

    def job(self, job_id: str) -> Job:
        with self.database.read() as session:
            return session.get_one(Job, job_id)

    def close_context(self) -> None:
        if self._context is not None:
            self._context.close()

    def close(self) -> None:
        self.close_context()
        self.database.dispose()


@pytest.fixture
def make_world(tmp_path: Path) -> Iterator[Callable[..., World]]:
    """Make a world on a database, with other settings where given."""
    worlds: list[World] = []

    def make(database_url: str, **changes: Any) -> World:
        worlds.append(World(worker_settings(tmp_path, database_url, **changes)))
        return worlds[-1]

    yield make
    for world in worlds:
        world.close()


@pytest.fixture
def world(make_world: Callable[..., World], sqlite_url: str) -> World:
    """A world on SQLite without a broker: jobs are run in the test's own process."""
    return make_world(sqlite_url)


class RunningWorker:
    """A real `exceptiondrive-worker run`, in a process group of its own."""

    def __init__(self, settings: WorkerSettings, log: Path, *arguments: str) -> None:
        environment = {
            f"EXCEPTIONDRIVE_{name.upper()}": str(value)
            for name, value in settings.model_dump().items()
            if value is not None
        }
        # compiled once for all workers of the suite, and outside of the checkout
        environment["PYTHONPYCACHEPREFIX"] = f"{tempfile.gettempdir()}/exceptiondrive-tests-pycache"
        inherited = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}
        code = "from exceptiondrive_worker.operator_cli import main; main()"
        with log.open("ab") as stream:
            self.process = subprocess.Popen(
                [sys.executable, "-c", code, "run", *arguments],
                env=inherited | environment,
                stdout=stream,
                stderr=stream,
                start_new_session=True,
            )

    @property
    def children(self) -> list[int]:
        """Ids of the processes that score."""
        pid = self.process.pid
        try:
            text = Path(f"/proc/{pid}/task/{pid}/children").read_text()
        except FileNotFoundError:
            return []
        return [int(child) for child in text.split()]

    def kill_children(self) -> int:
        """SIGKILL to every process that scores; return how many there were."""
        children = self.children
        for child in children:
            with contextlib.suppress(ProcessLookupError):
                os.kill(child, signal.SIGKILL)
        return len(children)

    def kill_all(self) -> None:
        """SIGKILL to the whole worker."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()

    def stop(self) -> int:
        """SIGTERM, as an operator stops it; return the exit code."""
        self.process.terminate()
        try:
            return self.process.wait(timeout=30)
        finally:
            self.kill_all()


@pytest.fixture
def run_worker(tmp_path: Path) -> Iterator[Callable[..., RunningWorker]]:
    """Start real workers; whatever still runs is killed at the end."""
    workers: list[RunningWorker] = []

    def run(world: World, *arguments: str) -> RunningWorker:
        workers.append(RunningWorker(world.settings, tmp_path / "worker.log", *arguments))
        return workers[-1]

    yield run
    for worker in workers:
        worker.kill_all()


@pytest.fixture
def run_reconciler() -> Iterator[Callable[[World], None]]:
    """Reconcile in a thread until the end of the test."""
    stop, threads = threading.Event(), []

    def run(world: World) -> None:
        dispatcher = Dispatcher(world.settings.broker_url)
        arguments = (world.database, dispatcher, world.settings, stop)
        threads.append(threading.Thread(target=reconcile, args=arguments))
        threads[-1].start()

    yield run
    stop.set()
    for thread in threads:
        thread.join()


@pytest.fixture(scope="session")
def wait_until() -> Callable[..., float]:
    """Wait until a question is answered with yes; fail after a minute."""
    return processes.wait_until


@pytest.fixture
def embedded(make_world: Callable[..., World], sqlite_url: str, broker_url: str) -> World:
    """SQLite and a private broker, as `make run` has them."""
    return make_world(sqlite_url, broker_url=broker_url, **QUICK)
