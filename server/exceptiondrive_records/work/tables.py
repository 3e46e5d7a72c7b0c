"""The tables of work."""

from datetime import datetime

from sqlalchemy import ForeignKey, Index, UniqueConstraint
from sqlalchemy.orm import Mapped, mapped_column

from exceptiondrive_records.db.base import Base, JobState
from exceptiondrive_schemas.jobs import Lane


class Job(Base):
    """One scoring run to be done: submission x protocol x split revision."""

    __tablename__ = "jobs"
    __table_args__ = (
        UniqueConstraint("submission_id", "protocol_digest", "split_revision"),
        Index("ix_jobs_queue", "state", "lane", "created_at"),
        Index("ix_jobs_finished", "finished_at"),
    )
    id: Mapped[str] = mapped_column(primary_key=True)
    submission_id: Mapped[str] = mapped_column(ForeignKey("submissions.id"))
    protocol_digest: Mapped[str] = mapped_column(ForeignKey("protocols.digest"))
    split_revision: Mapped[str]
    lane: Mapped[Lane]
    is_first: Mapped[bool]
    """The submission shows the fate of this job; a rescoring job leaves it untouched."""
    state: Mapped[JobState]
    attempts: Mapped[int]
    fence: Mapped[int]
    created_at: Mapped[datetime]
    available_at: Mapped[datetime]
    leased_at: Mapped[datetime | None]
    lease_until: Mapped[datetime | None]
    finished_at: Mapped[datetime | None]
    rung_at: Mapped[datetime | None]
    """When a worker was last called for it and has not come yet."""
    rings: Mapped[int]


class BoardRequest(Base):
    """A board is to be built while `wanted` is above `built`."""

    __tablename__ = "board_requests"
    phase_id: Mapped[str] = mapped_column(ForeignKey("phases.id"), primary_key=True)
    protocol_digest: Mapped[str] = mapped_column(ForeignKey("protocols.digest"), primary_key=True)
    split_revision: Mapped[str] = mapped_column(primary_key=True)
    wanted: Mapped[int]
    built: Mapped[int]
    fence: Mapped[int]
    lease_until: Mapped[datetime | None]
    rung_at: Mapped[datetime | None]
    built_at: Mapped[datetime | None]
    build_s: Mapped[float | None]
    """How long the last build took, by the database's clock."""


class WorkerHeartbeat(Base):
    """The last sign of life of a worker."""

    __tablename__ = "worker_heartbeats"
    worker_id: Mapped[str] = mapped_column(primary_key=True)
    at: Mapped[datetime]
    lanes: Mapped[list[str]]
    slots: Mapped[int]
    scorer_version: Mapped[str | None]
    """Whose scores it makes; None: a release that did not say."""


class Leader(Base):
    """Who may do what only one process may do."""

    __tablename__ = "leaders"
    name: Mapped[str] = mapped_column(primary_key=True)
    holder: Mapped[str]
    lease_until: Mapped[datetime]


class TeamTurn(Base):
    """When a worker last took a live job of a team; who never had one has no row."""

    __tablename__ = "team_turns"
    team_id: Mapped[int] = mapped_column(ForeignKey("teams.id"), primary_key=True)
    served_at: Mapped[datetime]
