"""How long fresh submissions waited, and whether a run in the background made them wait longer."""

from dataclasses import dataclass
from statistics import median

from sqlalchemy import select

from exceptiondrive_records.db.database import Database
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.work.tables import Job

ALLOWED_RATIO = 2.0
"""A run may double the waiting time of fresh submissions, and no more."""


@dataclass(frozen=True)
class Waits:
    """Seconds from upload to score, and of these until a worker last took the job, by submission."""

    to_score_s: tuple[float, ...]
    to_worker_s: tuple[float, ...]

    def __str__(self) -> str:
        score, worker = median(self.to_score_s), median(self.to_worker_s)
        return f"{score:.2f} s (max {max(self.to_score_s):.2f}), {worker:.2f} s for a worker"


def waits_of(database: Database, ids: list[str]) -> Waits:
    """Return the waits of these submissions."""
    query = (
        select(Submission.received_at, Submission.status_at, Job.leased_at)
        .join(Job, (Job.submission_id == Submission.id) & Job.is_first)
        .where(Submission.id.in_(ids))
    )
    with database.read() as session:
        rows = session.execute(query).all()
    return Waits(
        tuple((scored - received).total_seconds() for received, scored, _ in rows),
        tuple((leased - received).total_seconds() for received, _, leased in rows if leased),
    )


def ratio(with_run: Waits, without: Waits) -> float:
    """Return how many times as long the median submission waits."""
    return median(with_run.to_score_s) / median(without.to_score_s)
