"""Any interleaving of submissions, deliveries, crashes and losses ends every submission, once.

Hypothesis drives the real records, the real dispatcher and a real broker. A worker is a claim that
is held; a crash forgets it; a frozen worker answers late; time is moved by moving recorded times.
"""

import shutil
from collections.abc import Callable
from datetime import timedelta
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
from sqlalchemy import func, select
from tests.records.world import build_world
from tests.support.work import is_job, let_time_pass

from exceptiondrive_records.audit.log import verify_audit
from exceptiondrive_records.audit.tables import AuditLine
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.db.errors import Conflict
from exceptiondrive_records.db.settings import RecordsSettings
from exceptiondrive_records.operations.reconciler import reconcile_once
from exceptiondrive_records.submissions.submissions import withdraw
from exceptiondrive_records.submissions.tables import ScoreSheetRow, Submission
from exceptiondrive_records.work import jobs
from exceptiondrive_records.work.dispatch import Dispatcher, wake_lanes
from exceptiondrive_records.work.heartbeats import beat
from exceptiondrive_records.work.tables import Job, WorkState
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.faults import CheckReport
from exceptiondrive_schemas.jobs import Lane

MAX_ATTEMPTS = 2
N_WORKERS = 2
REPORT = CheckReport(
    challenge=None, split=None, n_predictions=None, digest="sha256:x", size_bytes=1
)
STEPS = [
    *("submit", "deliver", "deliver again", "withdraw", "reconcile", "an hour passes"),
    *("the broker loses everything", "crash", "freeze", "freeze"),
    *("scored", "scored", "rejected", "retry", "failed"),
]
ANY = st.integers(min_value=0, max_value=1_000)


class Lifecycle(RuleBasedStateMachine):
    """Submissions, workers and faults on one database and one broker."""

    new_world: ClassVar[Callable[[], Any]]
    broker: ClassVar[Any]

    def __init__(self) -> None:
        super().__init__()
        self.world = type(self).new_world()
        self.database: Database = self.world.database
        self.client = self.broker.client()
        self.client.flushall()
        self.dispatcher = Dispatcher(self.broker.url)
        self.settings = RecordsSettings(max_attempts=MAX_ATTEMPTS)
        with self.database.write() as session:
            for number in range(N_WORKERS):
                beat(session, f"worker-{number}")
        self.held: list[Job] = []
        self.jobs: list[str] = []
        self.ended: dict[str, SubmissionStatus] = {}

    @initialize()
    def begin_with_work(self) -> None:
        for content in range(3):
            self.submit(content, wakes=True)
        self.take(self.jobs[0])

    @rule(what=st.sampled_from(STEPS), which=ANY, flag=st.booleans())
    def step(self, what: str, which: int, flag: bool) -> None:
        """Do one thing; a single rule, so that every run mixes all of them."""
        if what == "submit":
            self.submit(which, wakes=flag)
        elif what == "deliver":
            self.deliver_a_message()
        elif what == "deliver again":
            self.take(self.jobs[which % len(self.jobs)])
        elif what == "withdraw":
            self.the_team_withdraws(which)
        elif what == "reconcile":
            self.reconcile()
        elif what == "an hour passes":
            self.an_hour_passes()
        elif what == "the broker loses everything":
            self.client.flushall()
        elif self.held:
            self.something_happens_to_a_worker(what, which, flag)

    def something_happens_to_a_worker(self, what: str, which: int, flag: bool) -> None:
        claim = self.held[which % len(self.held)]
        if what == "crash":
            self.held.remove(claim)
        elif what == "freeze":  # so long that another comes
            self.an_hour_passes()
            self.take(claim.id)
        else:
            self.answer(claim, what, keeps=flag)

    def submit(self, content: int, *, wakes: bool) -> None:
        file = content % 5  # the same file under another name is refused
        accepted = self.world.submit(f"file {file}", method=f"m{file % 3}")
        if accepted.job_id is None:
            assert accepted.is_duplicate
            return
        self.jobs.append(accepted.job_id)
        if wakes:
            wake_lanes(self.database, self.dispatcher, self.settings)

    def deliver_a_message(self) -> None:
        """Whoever is woken takes what comes next, whatever the message was sent for."""
        if self.client.rpop("ed:live") is not None:
            self.take(None)

    def take(self, job_id: str | None) -> None:
        which = () if job_id is None else (is_job(job_id),)
        with self.database.write() as session:
            claim = jobs.claim_job(session, Lane.LIVE, 120, MAX_ATTEMPTS, *which)
        if claim is not None:
            assert claim.attempts <= MAX_ATTEMPTS
            assert job_id in (None, claim.id)
            self.held.append(claim)

    def answer(self, claim: Job, answer: str, *, keeps: bool) -> None:
        """A worker answers; one that `keeps` its claim answers a second time some day."""
        if not keeps:
            self.held.remove(claim)
        with self.database.read() as session:
            job = session.get_one(Job, claim.id)
            holds_the_lease = job.state is WorkState.LEASED and job.fence == claim.fence
        assert self.finish(claim, answer) is holds_the_lease

    def finish(self, claim: Job, answer: str) -> bool:
        if answer == "scored":
            done: bool = self.world.finish(claim)
            return done
        with self.database.write() as session:
            if answer == "rejected":
                return jobs.finish_rejected(session, claim, REPORT)
            retry = answer == "retry"
            return jobs.finish_failed(
                session, claim, "internal", "We failed.", retry=retry, max_attempts=MAX_ATTEMPTS
            )

    def an_hour_passes(self) -> None:
        with self.database.write() as session:
            let_time_pass(session, timedelta(hours=1))
            for number in range(N_WORKERS):
                beat(session, f"worker-{number}")

    def the_team_withdraws(self, which: int) -> None:
        with self.database.write() as session:
            ids = list(session.scalars(select(Submission.id).order_by(Submission.id)))
            submission_id = ids[which % len(ids)]
            try:
                withdraw(session, submission_id, actor="test")
            except Conflict:
                return
            self.ended[submission_id] = SubmissionStatus.WITHDRAWN

    def reconcile(self) -> None:
        reconcile_once(self.database, self.dispatcher, self.settings)

    @invariant()
    def what_has_ended_stays_as_it_ended(self) -> None:
        with self.database.read() as session:
            for submission in session.scalars(select(Submission)):
                if submission.status.is_terminal:
                    was = self.ended.setdefault(submission.id, submission.status)
                    assert submission.status is was
                else:
                    assert submission.id not in self.ended

    @invariant()
    def jobs_and_submissions_agree(self) -> None:
        with self.database.read() as session:
            pairs = session.execute(
                select(Submission, Job).join(Job, Job.submission_id == Submission.id)
            )
            for submission, job in pairs:
                assert job.attempts <= MAX_ATTEMPTS
                assert submission.status.is_terminal is job.state.is_final
                if job.state is WorkState.LEASED:
                    assert submission.status is SubmissionStatus.SCORING

    @invariant()
    def nothing_is_scored_twice_or_without_a_sheet(self) -> None:
        with self.database.read() as session:
            sheets = set(session.scalars(select(ScoreSheetRow.submission_id)))
            lines = list(
                session.scalars(
                    select(AuditLine.subject).where(AuditLine.action == "submission scored")
                )
            )
            assert sorted(lines) == sorted(sheets)
            scored = select(Submission.id).where(Submission.status == SubmissionStatus.SCORED)
            assert set(session.scalars(scored)) <= sheets

    @invariant()
    def no_more_messages_wait_than_there_are_workers(self) -> None:
        assert self.client.llen("ed:live") <= N_WORKERS

    def teardown(self) -> None:
        """Faults stop: everything ends within a bounded number of passes."""
        self.held.clear()
        with self.database.write() as session:
            n_jobs = session.scalar(select(func.count()).select_from(Job)) or 0
        for _ in range(n_jobs * (MAX_ATTEMPTS + 1) + 2):
            self.an_hour_passes()
            self.reconcile()
            while self.client.llen("ed:live"):
                self.deliver_a_message()
            while self.held:
                self.finish(self.held.pop(), "scored")
        self.what_has_ended_stays_as_it_ended()
        with self.database.read() as session:
            open_jobs = select(Job.id).where(Job.state.in_((WorkState.QUEUED, WorkState.LEASED)))
            assert list(session.scalars(open_jobs)) == []
            assert verify_audit(session).is_whole
        self.dispatcher.close()
        self.client.close()
        self.database.dispose()


@pytest.fixture
def lifecycle(request: pytest.FixtureRequest, broker: Any) -> type[Lifecycle]:
    """The machine with its broker."""
    return type("Lifecycle", (Lifecycle,), {"broker": broker})


def run(machine: type[Lifecycle], n_examples: int) -> None:
    run_state_machine_as_test(
        machine,
        settings=settings(
            max_examples=n_examples,
            stateful_step_count=50,
            deadline=None,
            derandomize=True,
            suppress_health_check=list(HealthCheck),
        ),
    )


def test_every_interleaving_ends_every_submission_once_on_sqlite(
    lifecycle: type[Lifecycle], migrated_sqlite: Any, tmp_path: Any
) -> None:
    numbers = iter(range(1_000_000))

    def new_world() -> Any:
        path = tmp_path / f"{next(numbers)}.sqlite3"
        shutil.copy(migrated_sqlite, path)
        return build_world(Database(f"sqlite:///{path}"))

    lifecycle.new_world = staticmethod(new_world)
    run(lifecycle, 12)


@pytest.mark.postgres
def test_every_interleaving_ends_every_submission_once_on_postgres(
    lifecycle: type[Lifecycle], postgres: Any
) -> None:
    names: list[str] = []

    def new_world() -> Any:
        names.append(postgres.create("migrated"))
        return build_world(Database(postgres.url(names[-1])))

    lifecycle.new_world = staticmethod(new_world)
    try:
        run(lifecycle, 4)
    finally:
        for name in names:
            postgres.drop(name)
