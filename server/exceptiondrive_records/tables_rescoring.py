"""Tables of rescoring: runs, verifications, and what teams are told of them."""

from datetime import datetime
from enum import StrEnum

from sqlalchemy import ForeignKey, Index, Text, UniqueConstraint
from sqlalchemy.orm import Mapped, mapped_column

from exceptiondrive_records.columns import DocumentText, enum_text
from exceptiondrive_records.db.base import Base
from exceptiondrive_records.work.tables_of_work import WorkItem, WorkState
from exceptiondrive_schemas.rescoring import Comparison, RunState, VerifyState


class Channel(StrEnum):
    """How a team is told besides its inbox."""

    WEBHOOK = "webhook"
    EMAIL = "email"


class DeliveryState(StrEnum):
    """Where a message to the outside stands."""

    WAITING = "waiting"
    SENT = "sent"
    GIVEN_UP = "given_up"


class RescoringRun(Base):
    """One change of the protocol or split revision of a phase, from draft to its end."""

    __tablename__ = "rescoring_runs"
    __table_args__ = (Index("ix_rescoring_runs_phase", "phase_id", "state"),)
    id: Mapped[str] = mapped_column(primary_key=True)
    phase_id: Mapped[str] = mapped_column(ForeignKey("phases.id"))
    from_protocol_digest: Mapped[str] = mapped_column(ForeignKey("protocols.digest"))
    from_split_revision: Mapped[str]
    to_protocol_digest: Mapped[str] = mapped_column(ForeignKey("protocols.digest"))
    to_split_revision: Mapped[str]
    state: Mapped[RunState] = mapped_column(enum_text(RunState))
    reason: Mapped[str] = mapped_column(Text)
    actor: Mapped[str]
    created_at: Mapped[datetime]
    state_at: Mapped[datetime]
    started_at: Mapped[datetime | None]
    resumed_at: Mapped[datetime | None]
    """When scoring last began or went on: the rate counts from here."""
    applied_at: Mapped[datetime | None]
    ended_at: Mapped[datetime | None]
    from_board_id: Mapped[int | None] = mapped_column(ForeignKey("boards.id"))
    """The board that was current when the run was applied."""
    to_board_id: Mapped[int | None] = mapped_column(ForeignKey("boards.id"))
    apply_flip_id: Mapped[int | None] = mapped_column(ForeignKey("board_flips.id"))
    rollback_flip_id: Mapped[int | None] = mapped_column(ForeignKey("board_flips.id"))
    comparison: Mapped[Comparison | None] = mapped_column(DocumentText(Comparison), deferred=True)
    """What readers saw change, kept when the run was applied."""


class Verification(Base):
    """A recomputation of score sheets from the uploads, to prove that every bit comes again."""

    __tablename__ = "verifications"
    id: Mapped[str] = mapped_column(primary_key=True)
    phase_id: Mapped[str] = mapped_column(ForeignKey("phases.id"))
    protocol_digest: Mapped[str] = mapped_column(ForeignKey("protocols.digest"))
    split_revision: Mapped[str]
    reason: Mapped[str] = mapped_column(Text)
    actor: Mapped[str]
    created_at: Mapped[datetime]
    finished_at: Mapped[datetime | None]


class VerificationItem(Base):
    """One sheet that is recomputed."""

    __tablename__ = "verification_items"
    __table_args__ = (
        UniqueConstraint("verification_id", "submission_id"),
        Index("ix_verification_items_state", "state"),
    )
    id: Mapped[str] = mapped_column(primary_key=True)
    verification_id: Mapped[str] = mapped_column(ForeignKey("verifications.id"))
    submission_id: Mapped[str] = mapped_column(ForeignKey("submissions.id"))
    state: Mapped[VerifyState] = mapped_column(enum_text(VerifyState))
    expected_digest: Mapped[str]
    found_digest: Mapped[str | None]
    note: Mapped[str | None]
    attempts: Mapped[int]
    fence: Mapped[int]
    lease_until: Mapped[datetime | None]
    rung_at: Mapped[datetime | None]


class ContactPoint(Base):
    """Where a team wants to be told besides its inbox."""

    __tablename__ = "contact_points"
    id: Mapped[str] = mapped_column(primary_key=True)
    team_id: Mapped[int] = mapped_column(ForeignKey("teams.id"), index=True)
    channel: Mapped[Channel] = mapped_column(enum_text(Channel))
    address: Mapped[str]
    secret: Mapped[str | None]
    """Signs the webhooks of this address; shown to the team once."""
    created_at: Mapped[datetime]
    removed_at: Mapped[datetime | None]


class Notification(Base):
    """A message in the inbox of a team."""

    __tablename__ = "notifications"
    __table_args__ = (
        Index("ix_notifications_team", "team_id", "created_at"),
        UniqueConstraint("team_id", "run_id", "kind"),
    )
    id: Mapped[str] = mapped_column(primary_key=True)
    team_id: Mapped[int] = mapped_column(ForeignKey("teams.id"))
    run_id: Mapped[str | None] = mapped_column(ForeignKey("rescoring_runs.id"))
    kind: Mapped[str]
    body: Mapped[str] = mapped_column(Text)
    """The document that is shown and sent, as canonical JSON."""
    created_at: Mapped[datetime]
    read_at: Mapped[datetime | None]


class Delivery(WorkItem):
    """The outbox: one message to one address outside."""

    __mapper_args__ = {"polymorphic_identity": "delivery"}  # noqa: RUF012
    notification_id: Mapped[str] = mapped_column(ForeignKey("notifications.id"), nullable=True)
    contact_id: Mapped[str] = mapped_column(ForeignKey("contact_points.id"), nullable=True)

    @property
    def outcome(self) -> DeliveryState:
        """Where it stands."""
        if self.state is WorkState.DONE:
            return DeliveryState.SENT
        return DeliveryState.GIVEN_UP if self.state.is_final else DeliveryState.WAITING
