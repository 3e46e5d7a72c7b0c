"""The tables of work: one row for each item, with its lease; and heartbeats of workers."""

from datetime import datetime
from enum import StrEnum

from sqlalchemy import CheckConstraint, ForeignKey, Index, UniqueConstraint, literal_column, text
from sqlalchemy.orm import Mapped, mapped_column

from exceptiondrive_records.db.base import Base
from exceptiondrive_records.db.columns import DocumentText, enum_text
from exceptiondrive_schemas.api.rescoring import SplitTrial
from exceptiondrive_schemas.jobs import Lane


class WorkState(StrEnum):
    """The state of a work item. The last four are final."""

    QUEUED = "queued"
    HELD = "held"
    """It waits until its rescoring run continues."""
    LEASED = "leased"
    DONE = "done"
    FAILED = "failed"
    DEAD = "dead"
    """Every attempt ended without an answer."""
    CANCELLED = "cancelled"
    """It was cancelled before it ended."""

    @property
    def is_final(self) -> bool:
        """Whether the item has ended."""
        return self not in OPEN_STATES


WAITING_STATES = (WorkState.QUEUED, WorkState.HELD)
OPEN_STATES = (*WAITING_STATES, WorkState.LEASED)


NEEDED = {
    "score": ("submission_id", "team_id", "protocol_digest", "split_revision", "is_first"),
    "board": ("phase_id", "protocol_digest", "split_revision"),
    "trial": ("run_id",),
    "profile": ("submission_id", "protocol_digest", "split_revision"),
    "recheck": ("run_id", "submission_id", "expected_digest"),
    "lead": ("holder",),
    "delivery": ("notification_id", "contact_id"),
}
"""Columns that must not be null, by kind."""


class WorkItem(Base):
    """An item of work. Each kind has its own class; all share this lease.

    A claim increments `fence`; a worker with an older one has lost the lease, and changes nothing.
    """

    __tablename__ = "work"
    __table_args__ = (
        UniqueConstraint("kind", "key"),
        Index("ix_work_queue", "state", "kind", "lane", "created_at"),
        Index("ix_work_finished", "kind", "finished_at"),
        *(
            CheckConstraint(
                f"kind <> '{kind}' OR ({' AND '.join(f'{name} IS NOT NULL' for name in names)})",
                name=f"needed_for_{kind}",
            )
            for kind, names in NEEDED.items()
        ),
    )
    __mapper_args__ = {"polymorphic_on": "kind"}  # noqa: RUF012 - SQLAlchemy reads it once
    id: Mapped[str] = mapped_column(primary_key=True)
    kind: Mapped[str]
    key: Mapped[str]
    """Identifies the work: two requests with the same key are one item."""
    lane: Mapped[Lane | None] = mapped_column(enum_text(Lane))
    """The lane whose workers are woken for it; None if it needs no worker."""
    state: Mapped[WorkState] = mapped_column(enum_text(WorkState))
    asked: Mapped[int]
    """Number of requests: if it grows while the work is being done, it is done once more."""
    attempts: Mapped[int]
    fence: Mapped[int]
    created_at: Mapped[datetime]
    """Start of its waiting time: when it was first requested, or queued again after its end."""
    available_at: Mapped[datetime]
    leased_at: Mapped[datetime | None]
    lease_until: Mapped[datetime | None]
    finished_at: Mapped[datetime | None]
    took_s: Mapped[float | None]
    """Seconds from the last claim to its end, by the database's clock."""
    note: Mapped[str | None]
    """Why the last attempt failed."""

    @property
    def subject(self) -> str:
        """Its subject in the audit log: its submission or run, if it has one."""
        own = getattr(self, "submission_id", None) or getattr(self, "run_id", None)
        return own or f"{self.kind}:{self.key}"


class Job(WorkItem):
    """A scoring job: submission x protocol x split revision."""

    __mapper_args__ = {"polymorphic_identity": "score"}  # noqa: RUF012
    submission_id: Mapped[str] = mapped_column(ForeignKey("submissions.id"), nullable=True)
    team_id: Mapped[int] = mapped_column(ForeignKey("teams.id"), nullable=True)
    """The team to whose fair share it counts."""
    protocol_digest: Mapped[str] = mapped_column(
        ForeignKey("protocols.digest"), nullable=True, use_existing_column=True
    )
    split_revision: Mapped[str] = mapped_column(nullable=True, use_existing_column=True)
    is_first: Mapped[bool] = mapped_column(nullable=True)
    """Whether the submission's status follows this job; rescoring jobs leave it unchanged."""


class BoardRequest(WorkItem):
    """A board to be built: phase x protocol x split revision."""

    __mapper_args__ = {"polymorphic_identity": "board"}  # noqa: RUF012
    phase_id: Mapped[str] = mapped_column(
        ForeignKey("phases.id", ondelete="CASCADE"), nullable=True
    )
    protocol_digest: Mapped[str] = mapped_column(
        ForeignKey("protocols.digest"), nullable=True, use_existing_column=True
    )
    split_revision: Mapped[str] = mapped_column(nullable=True, use_existing_column=True)

    @property
    def subject(self) -> str:
        """The phase."""
        return f"board:{self.phase_id}"


class Profile(WorkItem):
    """The profile of a scored file to be computed for its team, after its score."""

    __mapper_args__ = {"polymorphic_identity": "profile"}  # noqa: RUF012
    submission_id: Mapped[str] = mapped_column(
        ForeignKey("submissions.id"), nullable=True, use_existing_column=True
    )
    protocol_digest: Mapped[str] = mapped_column(
        ForeignKey("protocols.digest"), nullable=True, use_existing_column=True
    )
    split_revision: Mapped[str] = mapped_column(nullable=True, use_existing_column=True)


class Recheck(WorkItem):
    """A sheet that a verification recomputes; `note` says why it was not reproduced."""

    __mapper_args__ = {"polymorphic_identity": "recheck"}  # noqa: RUF012
    run_id: Mapped[str] = mapped_column(
        ForeignKey("rescoring_runs.id"), nullable=True, use_existing_column=True
    )
    submission_id: Mapped[str] = mapped_column(
        ForeignKey("submissions.id"), nullable=True, use_existing_column=True
    )
    expected_digest: Mapped[str] = mapped_column(nullable=True)
    found_digest: Mapped[str | None]


class Trial(WorkItem):
    """A test of a split under the target key of a rescoring run."""

    __mapper_args__ = {"polymorphic_identity": "trial"}  # noqa: RUF012
    run_id: Mapped[str] = mapped_column(
        ForeignKey("rescoring_runs.id"), nullable=True, use_existing_column=True
    )
    trial: Mapped[SplitTrial | None] = mapped_column(DocumentText(SplitTrial))


class Leader(WorkItem):
    """The lease of a role that one process holds at a time; `key` names it."""

    __mapper_args__ = {"polymorphic_identity": "lead"}  # noqa: RUF012
    holder: Mapped[str] = mapped_column(nullable=True)


Index("ix_work_submission", Job.submission_id)
Index("ix_work_run", Recheck.run_id)
Index("ix_work_share", Job.team_id, Job.lane, Job.leased_at)
_OPEN = text("state IN ('queued', 'leased')")
Index(
    "ix_work_turn",
    Job.team_id,
    Job.lane,
    Job.created_at,
    Job.id,
    sqlite_where=_OPEN,
    postgresql_where=_OPEN,
)
IS_OPEN_JOB = Job.state.in_([literal_column("'queued'"), literal_column("'leased'")])
"""Exactly the condition of the partial index `ix_work_turn`: no other condition can use it."""


class WorkerHeartbeat(Base):
    """The last heartbeat of a worker."""

    __tablename__ = "worker_heartbeats"
    worker_id: Mapped[str] = mapped_column(primary_key=True)
    at: Mapped[datetime]
    lives_until: Mapped[datetime]
    """Until when it counts as alive without a further heartbeat."""
    lanes: Mapped[list[str]]
    scorer_version: Mapped[str | None]
    """Version of its scorer; None for a release that did not report it."""
    missing_splits: Mapped[list[str]] = mapped_column(default=list)
    """Splits in use whose file it does not find or whose floors it cannot read: names, or
    `name@revision` if only that revision could not be found."""
