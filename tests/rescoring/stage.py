"""A phase with submissions, a worker's context, and a reconciler without a broker.

Jobs are run in the test's own process, as a worker runs them; the databases are real.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.rescoring.documents import planning_file, split_document
from tests.support.databases import as_role
from tests.support.records import add_phase
from tests.support.worker import (
    add_split,
    build_wanted_boards,
    due_jobs,
    score_submission,
    submit,
    worker_settings,
)

from exceptiondrive_records.boards.boards import current_board
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.db.roles import Role
from exceptiondrive_records.protocols.protocols import add_protocol
from exceptiondrive_records.rescoring import changes, flip
from exceptiondrive_records.rescoring.fan_out import tend_runs
from exceptiondrive_records.rescoring.runs import find_run
from exceptiondrive_records.rescoring.views import preview_of, run_view
from exceptiondrive_schemas.api.rescoring import RunView
from exceptiondrive_schemas.protocol import packaged_protocol_toml
from exceptiondrive_schemas.split import Split
from exceptiondrive_worker.context import WorkerContext, open_context
from exceptiondrive_worker.settings import WorkerSettings
from exceptiondrive_worker.verify_run import verify_next

STEP = {"reason": "because", "actor": "organizer"}


@dataclass
class Stage:
    """Records, files and a worker's context; every step of an organizer in one call."""

    settings: WorkerSettings
    context: WorkerContext
    database: Database
    """As the server sees it: on PostgreSQL every service has its own role."""
    reconciler: Database
    owner: Database
    """For tests that damage records."""
    submitted: list[str] = field(default_factory=list)

    def open_phase(self, challenge: str, split: Split | None = None) -> None:
        """Open the phase `dev` on the tiny split, under the packaged protocol."""
        self.add_protocol(packaged_protocol_toml())
        self.put_split(split or split_document())
        with self.database.write() as session:
            add_phase(
                session,
                challenge=challenge,
                split="tiny",
                quota_per_day=1000,
                rejected_per_day=1000,
            )

    def put_planners(self) -> None:
        """Score and rank three planners of two teams."""
        self.open_phase("planning")
        for speed_mps, method, team in ((1.0, "slow", "alpha"), (2.0, "middle", "alpha")):
            self.submit(speed_mps, method, team)
        self.submit(6.0, "fast", "beta")
        self.work()

    def submit(self, speed_mps: float, method: str, team: str = "alpha") -> str:
        return self.submit_file(planning_file(speed_mps), method, team)

    def submit_file(
        self, data: bytes, method: str, team: str = "alpha", linked_to: str | None = None
    ) -> str:
        files = self.context.files
        accepted = submit(self.database, files, data, method=method, team=team, linked_to=linked_to)
        self.submitted.append(accepted.submission.id)
        return accepted.submission.id

    def work(self, most: int = 1000) -> int:
        """Do what reconciler and workers do until nothing is left, or `most` jobs were run."""
        n_done = 0
        while n_done < most:
            tend_runs(self.reconciler, self.settings.max_attempts)
            jobs = due_jobs(self.database)[: most - n_done]
            for job_id in jobs:
                score_submission(self.context, job_id)
            n_done += len(jobs)
            if not jobs and not build_wanted_boards(self.context):
                break
        return n_done

    def draft(self, **target: str) -> str:
        with self.database.write() as session:
            return changes.create_run(session, "dev", **target, **STEP).id

    def add_protocol(self, toml: str) -> None:
        with self.database.write() as session:
            add_protocol(session, toml, "test")

    def step(self, what: str, run_id: str) -> None:
        with self.database.write() as session:
            getattr(changes, f"{what}_run")(session, run_id, **STEP)

    def ready(self, toml: str) -> str:
        """Carry a run to a new protocol until it may be applied."""
        version = toml.split('version = "')[1].split('"')[0]
        self.add_protocol(toml)
        run_id = self.draft(protocol=version)
        self.step("start", run_id)
        self.work()
        assert self.view(run_id).state.value == "ready"
        return run_id

    def view(self, run_id: str) -> RunView:
        with self.database.read() as session:
            return run_view(session, find_run(session, run_id))

    def preview(self, run_id: str) -> Any:
        with self.database.read() as session:
            return preview_of(session, run_id)

    def apply(self, run_id: str, preview: str | None = None) -> None:
        digest = preview or self.preview(run_id).digest
        with self.database.write() as session:
            flip.apply_run(session, run_id, preview=digest, **STEP)

    def rollback(self, run_id: str) -> None:
        with self.database.write() as session:
            flip.rollback_run(session, run_id, **STEP)

    def board(self) -> str:
        with self.database.read() as session:
            row = current_board(session, "dev")
            assert row is not None
            return row.body

    def put_split(self, split: Split, file_name: str = "split.json") -> str:
        """Put a split file where workers look, register it, and return its revision."""
        return add_split(self.context.database, self.settings.splits_dir, split, file_name)

    def verify_all(self) -> None:
        """Do what workers and reconciler do with a verification."""
        while verify_next(self.context):
            pass
        tend_runs(self.reconciler, self.settings.max_attempts)


@contextmanager
def open_stage(database_url: str, folder: Path) -> Iterator[Stage]:
    """A stage over records and a folder as they are."""
    settings = worker_settings(folder, as_role(database_url, Role.WORKER))
    server, reconciler = (
        Database(as_role(database_url, role)) for role in (Role.API, Role.RECONCILER)
    )
    owner = Database(database_url)
    made = Stage(settings, open_context(settings), server, reconciler, owner)
    yield made
    made.context.close()
    server.dispose()
    reconciler.dispose()
    owner.dispose()
