"""The tables of the system of record. Nothing in them may be withheld information."""

from datetime import datetime
from typing import Any

from sqlalchemy import ForeignKey, ForeignKeyConstraint, Index, Text, UniqueConstraint
from sqlalchemy import text as sql_text
from sqlalchemy.orm import Mapped, mapped_column

from exceptiondrive_records.columns import DocumentText
from exceptiondrive_records.db.base import Base
from exceptiondrive_schemas.faults import CheckReport
from exceptiondrive_schemas.phase_settings import PhasePolicy
from exceptiondrive_schemas.score_sheet import ScoreSheet
from exceptiondrive_schemas.split import Manifest
from exceptiondrive_schemas.submission import SubmissionStatus


class Team(Base):
    """Owns submissions."""

    __tablename__ = "teams"
    id: Mapped[int] = mapped_column(primary_key=True)
    slug: Mapped[str] = mapped_column(unique=True)
    name: Mapped[str] = mapped_column(unique=True)
    is_reference: Mapped[bool]
    created_at: Mapped[datetime]
    pending_since: Mapped[datetime | None]
    """Registered itself then, and submits nothing until an organizer approves."""
    registration_note: Mapped[str | None]
    """Who they say they are, for organizers."""


class Token(Base):
    """A bearer token; only the digest of its text is kept."""

    __tablename__ = "tokens"
    id: Mapped[str] = mapped_column(primary_key=True)
    team_id: Mapped[int | None] = mapped_column(ForeignKey("teams.id"), index=True)
    name: Mapped[str]
    scopes: Mapped[list[str]]
    secret_digest: Mapped[str]
    prefix: Mapped[str]
    created_at: Mapped[datetime]
    expires_at: Mapped[datetime | None]
    revoked_at: Mapped[datetime | None]
    last_used_at: Mapped[datetime | None]


class ProtocolRow(Base):
    """A protocol document, immutable."""

    __tablename__ = "protocols"
    digest: Mapped[str] = mapped_column(primary_key=True)
    version: Mapped[str] = mapped_column(unique=True)
    toml: Mapped[str] = mapped_column(Text)
    created_at: Mapped[datetime]


class SplitRow(Base):
    """What may be known of a split revision: its manifest and how large its families are."""

    __tablename__ = "splits"
    __table_args__ = (
        Index("uq_splits_public", "name", "revision", "public_file_digest", unique=True),
    )
    name: Mapped[str] = mapped_column(primary_key=True)
    revision: Mapped[str] = mapped_column(primary_key=True)
    title: Mapped[str]
    manifest: Mapped[Manifest] = mapped_column(DocumentText(Manifest), deferred=True)
    family_counts: Mapped[dict[str, int]]
    n_samples: Mapped[int]
    public_file_digest: Mapped[str | None]
    """Content digest of the whole split file, for development splits alone."""
    registered_at: Mapped[datetime]
    part: Mapped[str | None]
    """`public` or `private`: a part of `whole_revision`; its manifest names all samples, and
    `n_samples` and `family_counts` are those of the part. Which samples it has is withheld."""
    whole_revision: Mapped[str | None]


class Phase(Base):
    """A dated stage of a challenge."""

    __tablename__ = "phases"
    __table_args__ = (
        ForeignKeyConstraint(["split_name", "split_revision"], ["splits.name", "splits.revision"]),
    )
    id: Mapped[str] = mapped_column(primary_key=True)
    challenge: Mapped[str]
    title: Mapped[str]
    description: Mapped[str] = mapped_column(Text)
    split_name: Mapped[str]
    split_revision: Mapped[str]
    protocol_digest: Mapped[str] = mapped_column(ForeignKey("protocols.digest"))
    opens_at: Mapped[datetime | None]
    closes_at: Mapped[datetime | None]
    quota_per_day: Mapped[int]
    quota_total: Mapped[int | None]
    quota_concurrent: Mapped[int | None]
    """How many of a team may wait for their score at once."""
    rejected_per_day: Mapped[int]
    current_board_id: Mapped[int | None]
    shows_reported: Mapped[bool]
    created_at: Mapped[datetime]
    policy: Mapped[PhasePolicy] = mapped_column(DocumentText(PhasePolicy), default=PhasePolicy())
    unfrozen_at: Mapped[datetime | None]
    names_revealed_at: Mapped[datetime | None]
    pseudonym_salt: Mapped[str | None] = mapped_column(deferred=True)
    """Random; pseudonyms are keyed by it. Never shown to anyone."""
    late_board_id: Mapped[int | None]
    """The board of the late view."""


class Submission(Base):
    """The record of one upload."""

    __tablename__ = "submissions"
    __table_args__ = (
        Index("ix_submissions_team", "team_id", "phase_id", "received_at"),
        Index(
            "uq_submissions_same_bytes",
            "phase_id",
            "team_id",
            "file_digest",
            unique=True,
            sqlite_where=sql_text("status NOT IN ('withdrawn', 'failed')"),
            postgresql_where=sql_text("status NOT IN ('withdrawn', 'failed')"),
        ),
    )
    id: Mapped[str] = mapped_column(primary_key=True)
    phase_id: Mapped[str] = mapped_column(ForeignKey("phases.id"))
    team_id: Mapped[int] = mapped_column(ForeignKey("teams.id"))
    method: Mapped[str]
    description: Mapped[str] = mapped_column(Text)
    paper_url: Mapped[str | None]
    code_url: Mapped[str | None]
    file_digest: Mapped[str]
    size_bytes: Mapped[int]
    status: Mapped[SubmissionStatus]
    report: Mapped[CheckReport | None] = mapped_column(DocumentText(CheckReport))
    failure_code: Mapped[str | None]
    failure_message: Mapped[str | None]
    received_at: Mapped[datetime]
    status_at: Mapped[datetime]
    withdrawn_at: Mapped[datetime | None]
    linked_to: Mapped[str | None] = mapped_column(ForeignKey("submissions.id"))
    """The counterpart that its board entry is compared with."""
    arrived_at: Mapped[datetime | None]
    """When its first byte came, where that was noted: the deadline is judged by it."""
    chosen_at: Mapped[datetime | None]
    """When the team chose it for the board; the latest choice counts."""
    published_at: Mapped[datetime | None]
    """When the team made it public, in a phase that keeps entries private."""


class ScoreSheetRow(Base):
    """The published, rounded score sheet of one scoring run, immutable."""

    __tablename__ = "score_sheets"
    submission_id: Mapped[str] = mapped_column(ForeignKey("submissions.id"), primary_key=True)
    protocol_digest: Mapped[str] = mapped_column(ForeignKey("protocols.digest"), primary_key=True)
    split_revision: Mapped[str] = mapped_column(primary_key=True)
    sheet: Mapped[ScoreSheet] = mapped_column(DocumentText(ScoreSheet))
    exact_digest: Mapped[str]
    measurement_key: Mapped[str]
    scorer_version: Mapped[str]
    created_at: Mapped[datetime]


class BoardRow(Base):
    """A board snapshot, immutable: `body` holds the exact bytes that are served."""

    __tablename__ = "boards"
    __table_args__ = (UniqueConstraint("phase_id", "number"),)
    id: Mapped[int] = mapped_column(primary_key=True)
    phase_id: Mapped[str] = mapped_column(ForeignKey("phases.id"))
    protocol_digest: Mapped[str] = mapped_column(ForeignKey("protocols.digest"))
    split_revision: Mapped[str]
    number: Mapped[int]
    digest: Mapped[str]
    """Digest of what the board says (`Board.content_digest`), whatever its number and date."""
    body_digest: Mapped[str]
    """Digest of `body`: the strong ETag."""
    body: Mapped[str] = mapped_column(Text)
    published_at: Mapped[datetime]
    view: Mapped[str] = mapped_column(default="main")
    """`main`, or `late`: the board with late entries among the others."""


class BoardEntryRow(Base):
    """A submission that stands on a board, written with the board, immutable.

    Rows that the paper reported are no submissions and are not here.
    """

    __tablename__ = "board_entries"
    __table_args__ = (Index("ix_board_entries_submission", "submission_id", "board_id"),)
    board_id: Mapped[int] = mapped_column(ForeignKey("boards.id"), primary_key=True)
    submission_id: Mapped[str] = mapped_column(primary_key=True)
    rank: Mapped[int | None]


class BoardFlip(Base):
    """When the pointer `Phase.current_board_id` moved, append-only."""

    __tablename__ = "board_flips"
    __table_args__ = (Index("ix_board_flips_phase", "phase_id", "at"),)
    id: Mapped[int] = mapped_column(primary_key=True)
    phase_id: Mapped[str] = mapped_column(ForeignKey("phases.id"))
    board_id: Mapped[int] = mapped_column(ForeignKey("boards.id"))
    at: Mapped[datetime]


class AuditLine(Base):
    """Who did what, append-only and hash-chained."""

    __tablename__ = "audit_lines"
    id: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    at: Mapped[datetime]
    actor: Mapped[str]
    action: Mapped[str]
    subject: Mapped[str] = mapped_column(index=True)
    detail: Mapped[dict[str, Any]]
    previous_hash: Mapped[str]
    hash: Mapped[str]


class WorkerHeartbeat(Base):
    """The last sign of life of a worker."""

    __tablename__ = "worker_heartbeats"
    worker_id: Mapped[str] = mapped_column(primary_key=True)
    at: Mapped[datetime]
    lanes: Mapped[list[str]]
    slots: Mapped[int]
    scorer_version: Mapped[str | None]
    """Whose scores it makes; None: a release that did not say."""


class ReceiptKeyRow(Base):
    """The public half of a key that has signed receipts. It is kept for ever."""

    __tablename__ = "receipt_keys"
    key_id: Mapped[str] = mapped_column(primary_key=True)
    public_key: Mapped[str]
    first_used_at: Mapped[datetime]


from exceptiondrive_records import (  # noqa: F401 - one metadata
    tables_access,
    tables_drawings,
    tables_people,
    tables_rescoring,
    tables_similarity,
)
