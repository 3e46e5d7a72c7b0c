"""A worker's world: records, a split and what its team sends."""

import contextlib
import os
import signal
from pathlib import Path
from typing import Any

from tests.support.databases import as_role
from tests.support.forked import Forked, operate_worker
from tests.support.records import add_phase
from tests.support.worker import add_split, build_board_of, score_submission, submit

from exceptiondrive_records.boards.boards import current_board
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.db.roles import Role
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.protocols.protocols import add_protocol
from exceptiondrive_records.submissions.file_store import FileStore
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.work.board_requests import want_board
from exceptiondrive_records.work.tables import Job
from exceptiondrive_schemas.board import Board
from exceptiondrive_schemas.protocol import (
    packaged_protocol_toml,
)
from exceptiondrive_schemas.split import Split
from exceptiondrive_worker.context import WorkerContext, open_context
from exceptiondrive_worker.settings import WorkerSettings


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

    def protocol_digest(self, phase_id: str = "dev") -> str:
        with self.database.read() as session:
            return session.get_one(Phase, phase_id).protocol_digest

    def build_board(self, phase_id: str = "dev") -> Board:
        """Ask for the board of a phase, build it, and return the one that is shown then."""
        digest = self.protocol_digest(phase_id)
        with self.database.write() as session:
            want_board(session, phase_id, digest)
        build_board_of(self.context, phase_id, digest)
        with self.database.read() as session:
            row = current_board(session, phase_id)
            assert row is not None
            return Board.model_validate_json(row.body)

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


class RunningWorker:
    """A real `exceptiondrive-worker run`, in a process group of its own."""

    def __init__(self, settings: WorkerSettings, log: Path, *arguments: str) -> None:
        environment = {
            f"EXCEPTIONDRIVE_{name.upper()}": str(value)
            for name, value in settings.model_dump().items()
            if value is not None
        }
        self.process = Forked(operate_worker, ["run", *arguments], os.environ | environment, log)

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
        os.kill(self.process.pid, signal.SIGTERM)
        try:
            return self.process.wait(timeout=30)
        finally:
            self.kill_all()
