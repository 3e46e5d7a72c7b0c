"""Any interleaving of an organizer's steps with submissions, withdrawals, failures, lost workers and
two reconcilers keeps every invariant, and ends with every sheet that is due and no other.

Hypothesis drives the real records and the real scoring of a tiny split; time is moved by moving
recorded times.
"""

import shutil
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, suppress
from datetime import timedelta
from pathlib import Path
from typing import Any, ClassVar

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    rule,
    run_state_machine_as_test,
)
from sqlalchemy import select
from tests.rescoring.documents import new_protocol
from tests.rescoring.stage import Stage, open_stage
from tests.support.work import claim_this, unfinished
from tests.support.worker import build_wanted_boards, due_jobs, score_submission

from exceptiondrive_records.db.errors import Conflict, InvalidRecord
from exceptiondrive_records.operations.invariants import violations
from exceptiondrive_records.phases.scoring_keys import UNFINISHED, key_of_phase, new_key
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.rescoring.fan_out import tend_runs
from exceptiondrive_records.rescoring.progress import count_sheets
from exceptiondrive_records.rescoring.retry import retry_submission
from exceptiondrive_records.rescoring.runs import list_runs
from exceptiondrive_records.rescoring.tables import RescoringRun
from exceptiondrive_records.submissions.submissions import withdraw
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.work import jobs
from exceptiondrive_records.work.tables import BoardRequest, Job
from exceptiondrive_schemas.api.rescoring import RunState
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_worker.profile_run import describe_next

MAX_ATTEMPTS = 4
STEPS = [
    *("submit", "submit", "score", "score", "score", "lose a worker", "fail", "retry", "withdraw"),
    *("tend", "tend twice at once", "build", "an hour passes"),
    *("draft", "start", "pause", "resume", "cancel", "apply", "apply", "rollback", "close"),
]
ANY = st.integers(min_value=0, max_value=1_000)
REFUSED = (Conflict, InvalidRecord)


class Updates(RuleBasedStateMachine):
    """One phase, its submissions, and runs between protocols 1.0 and 1.1."""

    new_stage: ClassVar[Callable[[], AbstractContextManager[Stage]]]

    def __init__(self) -> None:
        super().__init__()
        self.opened = type(self).new_stage()
        self.stage = self.opened.__enter__()
        self.stage.open_phase("planning")
        self.n_submitted = 0

    @initialize()
    def begin_with_a_board(self) -> None:
        self.stage.add_protocol(new_protocol("1.1", "d_safe_m = 2.0", "d_safe_m = 4.5"))
        for _ in range(2):
            self.submit()
        self.stage.work()
        self.organize("draft")
        self.organize("start")

    @rule(what=st.sampled_from(STEPS), which=ANY)
    def step(self, what: str, which: int) -> None:
        """Do one thing; a single rule, so that every run mixes all of them."""
        if what == "submit":
            self.submit()
        elif what in ("score", "lose a worker", "fail"):
            self.something_happens_to_a_job(what, which)
        elif what in ("retry", "withdraw"):
            self.something_happens_to_a_submission(what, which)
        elif what == "tend":
            tend_runs(self.stage.database, MAX_ATTEMPTS)
        elif what == "tend twice at once":
            with ThreadPoolExecutor(2) as pool:
                list(pool.map(tend_runs, [self.stage.database] * 2, [MAX_ATTEMPTS] * 2))
        elif what == "build":
            build_wanted_boards(self.stage.context)
        elif what == "an hour passes":
            self.an_hour_passes()
        else:
            with suppress(*REFUSED):
                self.organize(what)

    def submit(self) -> None:
        self.n_submitted += 1
        self.stage.submit(1 + self.n_submitted / 100, f"m{self.n_submitted % 3}")

    def something_happens_to_a_job(self, what: str, which: int) -> None:
        due = due_jobs(self.stage.database)
        if not due:
            return
        job_id = due[which % len(due)]
        if what == "score":
            score_submission(self.stage.context, job_id)
            return
        with self.stage.database.write() as session:
            claim = claim_this(session, job_id, 120, MAX_ATTEMPTS)
        if claim is not None and what == "fail":
            with self.stage.database.write() as session:
                jobs.finish_failed(session, claim, "internal", "We failed.", retry=False)

    def something_happens_to_a_submission(self, what: str, which: int) -> None:
        submission_id = self.stage.submitted[which % len(self.stage.submitted)]
        act = withdraw if what == "withdraw" else retry_submission
        with suppress(*REFUSED), self.stage.database.write() as session:
            act(session, submission_id, actor="test")

    def organize(self, what: str) -> None:
        """Take a step of the newest run; what the records refuse changes nothing."""
        if what == "draft":
            with self.stage.database.read() as session:
                shown = session.get_one(Phase, "dev").protocol_digest
                newest = session.scalars(select(RescoringRun)).first()
            began_from = shown if newest is None else newest.from_protocol_digest
            self.stage.draft(protocol="1.1" if shown == began_from else "1.0")
            return
        with self.stage.database.read() as session:
            query = select(RescoringRun.id).order_by(RescoringRun.created_at.desc())
            run_id = session.scalars(query).first()
        assert run_id is not None
        if what in ("apply", "rollback"):
            getattr(self.stage, what)(run_id)
        else:
            self.stage.step(what, run_id)

    def an_hour_passes(self) -> None:
        hour = timedelta(hours=1)
        with self.stage.database.write() as session:
            for job in session.scalars(select(Job)):
                if job.available_at.year < 9999:
                    job.available_at -= hour
                job.lease_until = job.lease_until and job.lease_until - hour
            for request in session.scalars(select(BoardRequest)):
                request.lease_until = request.lease_until and request.lease_until - hour

    @invariant()
    def every_promise_is_kept(self) -> None:
        with self.stage.database.read() as session:
            assert violations(session) == []
            assert len(list_runs(session, only_open=True)) <= 1

    def teardown(self) -> None:
        """Faults stop: whatever the organizer left behind, every sheet that is due comes."""
        for _ in range(MAX_ATTEMPTS + 1):
            with suppress(*REFUSED):
                self.organize("resume")  # also tries what failed again
            for submission_id in self.stage.submitted:
                with suppress(*REFUSED), self.stage.database.write() as session:
                    retry_submission(session, submission_id, actor="test")
            self.an_hour_passes()
            self._lose_no_lease()
            self.stage.work()
        while describe_next(self.stage.context):
            pass
        with self.stage.database.read() as session:
            statuses = set(session.scalars(select(Submission.status)))
            assert statuses <= {SubmissionStatus.SCORED, SubmissionStatus.WITHDRAWN}
            assert unfinished(session) == []
            phase = session.get_one(Phase, "dev")
            assert count_sheets(session, "dev", key_of_phase(phase)).missing == 0
            for run in session.scalars(select(RescoringRun)):
                if run.state in (*UNFINISHED, RunState.APPLIED):
                    assert count_sheets(session, "dev", new_key(run)).missing == 0
        self.every_promise_is_kept()
        self.opened.__exit__(None, None, None)

    def _lose_no_lease(self) -> None:
        """Jobs of workers that died are free again: take each up."""
        with self.stage.database.read() as session:
            held = list(session.scalars(select(Job.id).where(Job.lease_until.is_not(None))))
        for job_id in held:
            score_submission(self.stage.context, job_id)


def run(machine: type[Updates], n_examples: int) -> None:
    run_state_machine_as_test(
        machine,
        settings=settings(
            max_examples=n_examples,
            stateful_step_count=20,
            deadline=None,
            derandomize=True,
            suppress_health_check=list(HealthCheck),
        ),
    )


def test_every_interleaving_keeps_every_promise_on_sqlite(
    migrated_sqlite: Path, tmp_path: Path
) -> None:
    numbers = iter(range(1_000_000))

    def new_stage() -> Any:
        folder = tmp_path / str(next(numbers))
        folder.mkdir()
        shutil.copy(migrated_sqlite, folder / "records.sqlite3")
        return open_stage(f"sqlite:///{folder / 'records.sqlite3'}", folder)

    machine = type("Updates", (Updates,), {"new_stage": staticmethod(new_stage)})
    run(machine, 4)


@pytest.mark.postgres
def test_every_interleaving_keeps_every_promise_on_postgres(postgres: Any, tmp_path: Path) -> None:
    names: list[str] = []

    def new_stage() -> Any:
        names.append(postgres.create("migrated"))
        folder = tmp_path / str(len(names))
        folder.mkdir()
        return open_stage(postgres.url(names[-1]), folder)

    machine = type("Updates", (Updates,), {"new_stage": staticmethod(new_stage)})
    try:
        run(machine, 1)
    finally:
        for name in names:
            postgres.drop(name)
