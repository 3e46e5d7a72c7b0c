"""One topology with its clients, and what a fault may ask of it."""

import time
from dataclasses import dataclass, field
from statistics import quantiles

from sqlalchemy import func, select
from tests.chaos.checker import check
from tests.chaos.clients import Clients, digest_of
from tests.chaos.history import Call, History
from tests.chaos.topology import Topology

from exceptiondrive_records.audit import count_audit_lines
from exceptiondrive_records.invariants import unfinished
from exceptiondrive_records.reconciler import LEADERSHIP
from exceptiondrive_records.tables import Job, JobState, Leader, ScoreSheetRow, Submission
from exceptiondrive_records.violations import Violation
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_schemas.submission import SubmissionStatus

OPEN = (JobState.QUEUED, JobState.LEASED)


@dataclass
class Run:
    """A topology under load."""

    topology: Topology
    history: History = field(default_factory=History)
    clients: Clients = field(init=False)

    def __post_init__(self) -> None:
        self.clients = Clients(self.topology, self.history)

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
        self.topology.wait_until(lambda: self.count(JobState.LEASED), "a job being scored")

    def count(self, *states: JobState, lane: Lane | None = None) -> int:
        query = select(func.count()).select_from(Job).where(Job.state.in_(states))
        if lane is not None:
            query = query.where(Job.lane == lane)
        with self.topology.database.read() as session:
            return session.scalar(query) or 0

    def n_sheets(self) -> int:
        with self.topology.database.read() as session:
            return session.scalar(select(func.count()).select_from(ScoreSheetRow)) or 0

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
            return session.scalar(select(Leader.holder).where(Leader.name == LEADERSHIP))

    def n_retried(self) -> int:
        """How many jobs took more than one attempt."""
        with self.topology.database.read() as session:
            return session.scalar(select(func.count()).where(Job.attempts > 1)) or 0

    def settle(self, timeout_s: float = 120.0) -> float:
        """Wait until every job has ended and every board is built."""
        self.clients.join()
        started = time.monotonic()
        self.topology.wait_until(self._is_settled, "everything to settle", timeout_s)
        return time.monotonic() - started

    def _is_settled(self) -> bool:
        with self.topology.database.read() as session:
            return not unfinished(session)

    def violations(self) -> list[Violation]:
        return check(self.topology.database, self.topology.files, self.history)

    def calls_since(self, start_s: float) -> list[Call]:
        return [call for call in self.history.calls if call.started_s >= start_s]


def slowest_s(calls: list[Call]) -> float:
    """How long the slowest answered upload took."""
    return max((call.took_s for call in calls if call.status is not None), default=0.0)


def percentile(values: list[float], share: float) -> float:
    """Return a percentile of at least two values."""
    return quantiles(values, n=1000, method="inclusive")[round(share * 1000) - 1]
