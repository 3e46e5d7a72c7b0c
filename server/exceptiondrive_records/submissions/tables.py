"""The tables of submissions."""

from datetime import datetime

from sqlalchemy import ForeignKey, Index, String, Text
from sqlalchemy import text as sql_text
from sqlalchemy.orm import Mapped, mapped_column

from exceptiondrive_records.db.base import Base
from exceptiondrive_records.db.columns import DocumentText
from exceptiondrive_schemas.api.phase_settings import RunRule
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.faults import CheckReport
from exceptiondrive_schemas.method_facts import EditChanges, MethodFacts
from exceptiondrive_schemas.score_sheet import ScoreSheet


class Submission(Base):
    """The record of one upload."""

    __tablename__ = "submissions"
    __table_args__ = (
        Index("ix_submissions_team", "team_id", "phase_id", "received_at"),
        Index("ix_submissions_phase", "phase_id", "received_at"),
        Index("ix_submissions_status", "status", "phase_id"),
        Index(
            "uq_submissions_same_bytes",
            "phase_id",
            "team_id",
            "file_digest",
            unique=True,
            sqlite_where=sql_text("status NOT IN ('withdrawn', 'failed')"),
            postgresql_where=sql_text("status NOT IN ('withdrawn', 'failed')"),
        ),
        Index(
            "ix_submissions_edited",
            "phase_id",
            "edited_at",
            sqlite_where=sql_text("edited_at IS NOT NULL"),
            postgresql_where=sql_text("edited_at IS NOT NULL"),
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
    linked_to: Mapped[str | None] = mapped_column(
        ForeignKey("submissions.id", deferrable=True, initially="DEFERRED")
    )
    """The counterpart with which its board entry is compared."""
    arrived_at: Mapped[datetime | None]
    """When its first byte came, if recorded; this time must be within the deadline."""
    granted_until: Mapped[datetime | None]
    """A later deadline granted to its team; before it, the submission is not late."""
    chosen_at: Mapped[datetime | None]
    """When the team chose it, or a rule for its method, for the board; the latest choice counts."""
    chosen_rule: Mapped[RunRule] = mapped_column(String, default="this")
    """The choice: this run, or the best or newest one of its method."""
    idempotency_key: Mapped[str | None]
    """The sender's key of the upload, by which a repetition is recognized."""
    asks_first: Mapped[bool] = mapped_column(default=False)
    """Whether it counts only if nothing needs confirmation; else it is rejected with questions."""
    confirm_until: Mapped[datetime | None]
    """Until when its team may confirm it; an hour later its file is an orphan."""
    confirmed_as: Mapped[str | None]
    """The submission that counts in its place, after the team confirmed it."""
    published_at: Mapped[datetime | None]
    """When the team made it public, in a phase that keeps entries private."""
    facts: Mapped[MethodFacts | None] = mapped_column(DocumentText(MethodFacts))
    edited_at: Mapped[datetime | None]
    """When the team last edited name, description, links or facts; see `SubmissionEdit`."""

    @property
    def is_scored(self) -> bool:
        """Whether it has a score, and was not withdrawn."""
        return self.status is SubmissionStatus.SCORED

    @property
    def is_asked(self) -> bool:
        """Whether its file is valid, but counts only if its team confirms it, or had to."""
        return self.status is SubmissionStatus.REJECTED and self.confirm_until is not None

    def can_be_confirmed(self, now: datetime) -> bool:
        """Whether its team may still confirm it."""
        return self.is_asked and self.confirm_until is not None and now < self.confirm_until


class SubmissionEdit(Base):
    """An edit of a submission's description by its team; append-only."""

    __tablename__ = "submission_edits"
    id: Mapped[int] = mapped_column(primary_key=True)
    submission_id: Mapped[str] = mapped_column(ForeignKey("submissions.id"), index=True)
    edited_at: Mapped[datetime]
    actor: Mapped[str]
    changes: Mapped[EditChanges] = mapped_column(DocumentText(EditChanges))


class ScoreSheetRow(Base):
    """The published, rounded score sheet of one scoring run, immutable."""

    __tablename__ = "score_sheets"
    __table_args__ = (
        Index("ix_score_sheets_since", "split_revision", "created_at", "submission_id"),
        Index("ix_score_sheets_protocol", "protocol_digest", "split_revision"),
    )
    submission_id: Mapped[str] = mapped_column(ForeignKey("submissions.id"), primary_key=True)
    protocol_digest: Mapped[str] = mapped_column(ForeignKey("protocols.digest"), primary_key=True)
    split_revision: Mapped[str] = mapped_column(primary_key=True)
    sheet: Mapped[ScoreSheet] = mapped_column(DocumentText(ScoreSheet))
    exact_digest: Mapped[str]
    measurement_key: Mapped[str]
    scorer_version: Mapped[str]
    created_at: Mapped[datetime]


class ReceiptKeyRow(Base):
    """The public half of a key that has signed receipts, kept forever."""

    __tablename__ = "receipt_keys"
    key_id: Mapped[str] = mapped_column(primary_key=True)
    public_key: Mapped[str]
    first_used_at: Mapped[datetime]


class SimilarityRow(Base):
    """A submission that was compared with all submissions compared before it."""

    __tablename__ = "similarities"
    submission_id: Mapped[str] = mapped_column(ForeignKey("submissions.id"), primary_key=True)
    alike: Mapped[str] = mapped_column(Text)
    """`ALIKE_SUBMISSIONS` as JSON: the nearest of other teams, and of its own."""
