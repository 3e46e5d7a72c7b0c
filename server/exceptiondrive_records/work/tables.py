"""The work table, a row for each item with its lease; and the heartbeats of workers."""

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
    """It waits for its rescoring run to go on."""
    LEASED = "leased"
    DONE = "done"
    FAILED = "failed"
    DEAD = "dead"
    """Every attempt ended without an answer."""
    CANCELLED = "cancelled"
    """It was taken back first."""

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
"""By kind, the columns that are never empty; other kinds leave them empty."""


class WorkItem(Base):
    """An item of work. Each kind is a class of its own; all of them share this lease.

    A claim raises `fence`: whoever comes with an older one has lost the lease and changes nothing.
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
    """Names what is to be done: asked for twice, it is one item."""
    lane: Mapped[Lane | None] = mapped_column(enum_text(Lane))
    """Which workers are woken for it; None: it needs none."""
    state: Mapped[WorkState] = mapped_column(enum_text(WorkState))
    asked: Mapped[int]
    """How often it was asked for: what is asked for while it is done is done once more."""
    attempts: Mapped[int]
    fence: Mapped[int]
    created_at: Mapped[datetime]
    """Since when it waits, or waited: from when it was asked for, or queued again after its end."""
    available_at: Mapped[datetime]
    leased_at: Mapped[datetime | None]
    lease_until: Mapped[datetime | None]
    finished_at: Mapped[datetime | None]
    took_s: Mapped[float | None]
    """From the last claim to its end, by the database's clock."""
    note: Mapped[str | None]
    """Why the last attempt came to nothing."""

    @property
    def subject(self) -> str:
        """What the audit log calls it: its submission or its run, where it has one."""
        own = getattr(self, "submission_id", None) or getattr(self, "run_id", None)
        return own or f"{self.kind}:{self.key}"


class Job(WorkItem):
    """A scoring job: submission x protocol x split revision."""

    __mapper_args__ = {"polymorphic_identity": "score"}  # noqa: RUF012
    submission_id: Mapped[str] = mapped_column(ForeignKey("submissions.id"), nullable=True)
    team_id: Mapped[int] = mapped_column(ForeignKey("teams.id"), nullable=True)
    """Whose share of the workers it takes."""
    protocol_digest: Mapped[str] = mapped_column(
        ForeignKey("protocols.digest"), nullable=True, use_existing_column=True
    )
    split_revision: Mapped[str] = mapped_column(nullable=True, use_existing_column=True)
    is_first: Mapped[bool] = mapped_column(nullable=True)
    """The submission shows the fate of this job; a rescoring job leaves it untouched."""


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
"""Word for word the condition of `ix_work_turn`: an index of some rows serves no other question."""


class WorkerHeartbeat(Base):
    """The last sign of life of a worker."""

    __tablename__ = "worker_heartbeats"
    worker_id: Mapped[str] = mapped_column(primary_key=True)
    at: Mapped[datetime]
    lives_until: Mapped[datetime]
    """It counts as living until then, if it gives no other."""
    lanes: Mapped[list[str]]
    scorer_version: Mapped[str | None]
    """Whose scores it makes; None: a release that did not say."""
    missing_splits: Mapped[list[str]] = mapped_column(default=list)
    """Splits in use of which it finds no file or reads no floors: names, and `name@revision` where that
    revision was asked for in vain."""
