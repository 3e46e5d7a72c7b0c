"""One topology with its clients, and what a fault may ask of it."""

import time
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from functools import cached_property
from statistics import quantiles

from sqlalchemy import func, select
from tests.chaos.checker import check
from tests.chaos.checker_scores import LeakSearch, Rescorer, leaks_in_postgres
from tests.chaos.clients import Clients
from tests.chaos.history import Call, History
from tests.chaos.topology import LEASE_S, PHASE, Topology
from tests.support.documents import digest_of
from tests.support.records import count_audit_lines
from tests.support.work import unfinished

from exceptiondrive.inputs import given_split
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import Violation
from exceptiondrive_records.operations.reconciler import LEADERSHIP
from exceptiondrive_records.phases.quotas import quota_of
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.rescoring.runs import find_run
from exceptiondrive_records.submissions.tables import ScoreSheetRow, Submission
from exceptiondrive_records.teams.teams import find_team
from exceptiondrive_records.work.tables import Job, Leader, WorkerHeartbeat, WorkState
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_schemas.protocol import packaged_protocol

OPEN = (WorkState.QUEUED, WorkState.LEASED)
_AFTER_THE_LEASE_S = 5.0
"""For the reconciler's next pass, a message, and a worker's first poll of its queue; besides, as long as
a worker took to come back, since a full machine slows both down."""


@dataclass(frozen=True)
class Hit:
    """What a fault is about to hit: when, jobs with the beginning of their leases, workers."""

    at: datetime
    jobs: dict[str, datetime | None]
    workers: set[str]


@dataclass
class Run:
    """A topology under load."""

    topology: Topology
    is_short: bool = False
    """Whether numbers and waits are as small as the fault allows."""
    history: History = field(default_factory=History)
    clients: Clients = field(init=False)

    def __post_init__(self) -> None:
        self.clients = Clients(
            self.topology, self.history, looks_a_second=5 if self.is_short else 10
        )

    def close(self, *, keep: bool = False) -> None:
        try:
            self.clients.close()
        finally:
            self.topology.close(keep=keep)

    def upload(self, team: str = "alpha", order: str | None = None) -> Call:
        """Upload one new file, with an order to the saboteur for its scoring."""
        data = self.clients.new_file()
        if order is not None:
            self.topology.order(digest_of(data).removeprefix("sha256:"), order)
        return self.clients.submit(data, team)

    def slowly(self, seconds: float) -> None:
        """Let every scoring run take longer, so that a fault hits one."""
        self.topology.order("every-score", str(seconds))

    def at_full_speed(self) -> None:
        (self.topology.orders / "every-score").unlink(missing_ok=True)

    def wait_for_lease(self) -> None:
        """Wait until a worker is in the middle of scoring."""
        self.topology.wait_until(lambda: self.count(WorkState.LEASED), "a job being scored")

    def count(self, *states: WorkState, lane: Lane | None = None) -> int:
        query = select(func.count()).select_from(Job).where(Job.state.in_(states))
        if lane is not None:
            query = query.where(Job.lane == lane)
        with self.topology.database.read() as session:
            return session.scalar(query) or 0

    def n_sheets(self) -> int:
        with self.topology.database.read() as session:
            return session.scalar(select(func.count()).select_from(ScoreSheetRow)) or 0

    def sheets(self) -> dict[tuple[str, str], str]:
        """The text of every score sheet, by submission and protocol."""
        with self.topology.database.read() as session:
            return {
                (row.submission_id, row.protocol_digest): row.sheet.model_dump_json()
                for row in session.scalars(select(ScoreSheetRow))
            }

    def n_sheets_under(self, run_id: str) -> int:
        """How many sheets there are under the protocol that a rescoring run leads to."""
        with self.topology.database.read() as session:
            wanted = find_run(session, run_id).to_protocol_digest
            query = select(func.count()).where(ScoreSheetRow.protocol_digest == wanted)
            return session.scalar(query) or 0

    def lines(self, action: str) -> int:
        with self.topology.database.read() as session:
            return count_audit_lines(session, action)

    def status_of(self, call: Call) -> SubmissionStatus:
        with self.topology.database.read() as session:
            return session.get_one(Submission, call.submission_id).status

    def failure_of(self, call: Call) -> str | None:
        with self.topology.database.read() as session:
            return session.get_one(Submission, call.submission_id).failure_code

    def n_scored(self, call: Call) -> int:
        with self.topology.database.read() as session:
            query = select(func.count()).select_from(ScoreSheetRow)
            return (
                session.scalar(query.where(ScoreSheetRow.submission_id == call.submission_id)) or 0
            )

    def require_scored(self, calls: list[Call]) -> None:
        """Fail unless each of these was taken and has its score."""
        accepted = [call for call in calls if call.is_accepted]
        assert accepted, "nothing was submitted beside it"
        harmed = [call for call in accepted if self.status_of(call) is not SubmissionStatus.SCORED]
        told = [(self.status_of(call).value, self.failure_of(call)) for call in harmed]
        assert not told, f"{len(told)} of {len(accepted)} came to harm: {told}"

    def require_no_rows(self, calls: list[Call]) -> None:
        """Fail if one of these, which was told that nothing was taken, was taken after all."""
        digests = {call.file_digest for call in calls}
        with self.topology.database.read() as session:
            query = select(func.count()).where(Submission.file_digest.in_(digests))
            n_rows = session.scalar(query)
        assert n_rows == 0, f"{n_rows} rows of uploads that were refused"

    def used_today(self, team: str) -> int:
        """How much of its quota a team has used."""
        with self.topology.database.read() as session:
            phase = session.get_one(Phase, PHASE)
            return quota_of(session, find_team(session, team).id, phase).used_today

    def waiting(self) -> Hit:
        """The jobs that wait, and now."""
        return self._hit(WorkState.QUEUED)

    def held(self) -> Hit:
        """The jobs in the middle of being scored, and the workers that live now."""
        return self._hit(WorkState.LEASED)

    def _hit(self, state: WorkState) -> Hit:
        with self.topology.database.read() as session:
            jobs = session.execute(select(Job.id, Job.leased_at).where(Job.state == state))
            workers = session.scalars(select(WorkerHeartbeat.worker_id))
            return Hit(database_now(session), {row[0]: row[1] for row in jobs}, set(workers))

    def until_a_new_worker(self, hit: Hit) -> datetime:
        """Wait for the first sign of life of a worker that was not there; return when it came."""
        found: list[datetime] = []

        def is_there() -> bool:
            query = select(WorkerHeartbeat.at).where(WorkerHeartbeat.worker_id.not_in(hit.workers))
            with self.topology.database.read() as session:
                found.extend(session.scalars(query))
            return bool(found)

        self.topology.wait_until(is_there, "a worker to come back")
        return min(found)

    def require_taken_up(self, hit: Hit, back_at: datetime) -> str:
        """Fail unless what lost its worker was begun again as soon as lease and workers allow."""
        with self.topology.database.read() as session:
            jobs = list(session.scalars(select(Job).where(Job.id.in_(hit.jobs), Job.attempts > 1)))
        assert jobs, "every job had ended before: nothing was interrupted"
        late_s = 0.0
        for job in jobs:
            began_at = hit.jobs[job.id]
            assert began_at is not None
            assert job.leased_at is not None
            free_at = max(began_at + timedelta(seconds=LEASE_S), back_at)
            late_s = max(late_s, (job.leased_at - free_at).total_seconds())
        allowed_s = _AFTER_THE_LEASE_S + (back_at - hit.at).total_seconds()
        assert late_s <= allowed_s, (
            f"begun again {late_s:.1f} s after it could have been, {allowed_s:.1f} s allowed"
        )
        return f"{len(jobs)} begun again up to {late_s:.1f} s after lease and restart"

    def longest_wait_s(self, hit: Hit) -> float:
        """How long those that waited went on waiting until they were begun."""
        with self.topology.database.read() as session:
            query = select(Job.leased_at).where(Job.id.in_(hit.jobs))
            begun = [at for at in session.scalars(query) if at is not None]
        return max((at - hit.at).total_seconds() for at in begun)

    def job_of(self, call: Call) -> Job:
        with self.topology.database.read() as session:
            query = select(Job).where(Job.submission_id == call.submission_id, Job.is_first)
            return session.scalars(query).one()

    def wait_of_s(self, call: Call) -> float:
        """How long a submission waited from upload to its end."""
        with self.topology.database.read() as session:
            row = session.get_one(Submission, call.submission_id)
            return (row.status_at - row.received_at).total_seconds()

    def leader(self) -> str | None:
        with self.topology.database.read() as session:
            return session.scalar(select(Leader.holder).where(Leader.key == LEADERSHIP))

    def n_retried(self) -> int:
        """How many jobs took more than one attempt."""
        with self.topology.database.read() as session:
            return session.scalar(select(func.count()).where(Job.attempts > 1)) or 0

    def n_lost_leases(self) -> int:
        """How often a job was begun again without its worker having said why."""
        with self.topology.database.read() as session:
            query = select(func.sum(Job.attempts - 1)).where(Job.attempts > 1)
            return (session.scalar(query) or 0) - count_audit_lines(
                session, "scoring to be retried"
            )

    def settle(self, timeout_s: float = 120.0) -> float:
        """Wait until every job has ended and every board is built."""
        self.clients.join()
        started = time.monotonic()
        self.topology.wait_until(self._is_settled, "everything to settle", timeout_s)
        return time.monotonic() - started

    def _is_settled(self) -> bool:
        with self.topology.database.read() as session:
            return not unfinished(session)

    def violations(self, *, is_settled: bool = True) -> list[Violation]:
        topology = self.topology
        return check(topology.database, topology.files, self.history, is_settled=is_settled)

    def broken(self) -> list[Violation]:
        """Return all that is wrong when nothing is left to do: records, scores, and leaks."""
        with self.topology.database.read() as session:
            wrong = list(self._rescorer.wrong_scores(session, self.topology.files))
        leaks = list(self._leak_search.leaks())
        if self.topology.postgres is not None:
            leaks += leaks_in_postgres(self.topology.postgres)
        return [*self.violations(), *wrong, *leaks]

    @cached_property
    def _rescorer(self) -> Rescorer:
        split = given_split(self.topology.splits / "sample" / "split.json.gz")
        return Rescorer(split, packaged_protocol())

    @cached_property
    def _leak_search(self) -> LeakSearch:
        return LeakSearch(*{self.topology.folder, self.topology.data})

    def calls_since(self, start_s: float) -> list[Call]:
        return [call for call in self.history.calls if call.started_s >= start_s]


def slowest_s(calls: list[Call]) -> float:
    """How long the slowest answered upload took."""
    return max((call.took_s for call in calls if call.status is not None), default=0.0)


def percentile(values: list[float], share: float) -> float:
    """Return a percentile of at least two values."""
    return quantiles(values, n=1000, method="inclusive")[round(share * 1000) - 1]
