"""The tables of notifications."""

from datetime import datetime
from enum import StrEnum

from sqlalchemy import ForeignKey, Index, Text, UniqueConstraint
from sqlalchemy.orm import Mapped, mapped_column

from exceptiondrive_records.db.base import Base
from exceptiondrive_records.db.columns import enum_text
from exceptiondrive_records.work.tables import WorkItem, WorkState


class Channel(StrEnum):
    """How a team is notified in addition to its inbox."""

    WEBHOOK = "webhook"
    EMAIL = "email"


class DeliveryState(StrEnum):
    """The state of a message to an external address."""

    WAITING = "waiting"
    SENT = "sent"
    GIVEN_UP = "given_up"


class ContactPoint(Base):
    """An external address at which a team wants notices."""

    __tablename__ = "contact_points"
    id: Mapped[str] = mapped_column(primary_key=True)
    team_id: Mapped[int] = mapped_column(ForeignKey("teams.id"), index=True)
    channel: Mapped[Channel] = mapped_column(enum_text(Channel))
    address: Mapped[str]
    secret: Mapped[str | None]
    """For a webhook, the key that signs messages, shown to the team once; for an e-mail address,
    the key in the links that confirm and unsubscribe it."""
    wishes: Mapped[str] = mapped_column(default="updates")
    """Its `Subscription`s, separated by spaces."""
    confirmed_at: Mapped[datetime | None]
    """When its reader confirmed it; for a webhook, when it was added."""
    created_at: Mapped[datetime]
    removed_at: Mapped[datetime | None]
    mailbox_digest: Mapped[str | None] = mapped_column(index=True)
    """Digest of a normalized e-mail address; to count requests to it, and to remember a refusal."""
    unsubscribed_at: Mapped[datetime | None]
    """When its reader unsubscribed: the address is then deleted, as upon removal, and the digest
    stays. None again once they take it back."""


class Notification(Base):
    """A message in the inbox of a team."""

    __tablename__ = "notifications"
    __table_args__ = (
        Index("ix_notifications_team", "team_id", "created_at"),
        UniqueConstraint("team_id", "run_id", "kind"),
        UniqueConstraint("team_id", "kind", "subject"),
    )
    id: Mapped[str] = mapped_column(primary_key=True)
    team_id: Mapped[int] = mapped_column(ForeignKey("teams.id"))
    run_id: Mapped[str | None] = mapped_column(ForeignKey("rescoring_runs.id"))
    kind: Mapped[str]
    subject: Mapped[str | None]
    """Unique key of what it is about, if sent only once: a submission, or a phase and an hour."""
    body: Mapped[str] = mapped_column(Text)
    """The document shown and sent, as canonical JSON."""
    created_at: Mapped[datetime]
    read_at: Mapped[datetime | None]


class Delivery(WorkItem):
    """An item of the outbox: one message to one external address."""

    __mapper_args__ = {"polymorphic_identity": "delivery"}  # noqa: RUF012
    notification_id: Mapped[str] = mapped_column(ForeignKey("notifications.id"), nullable=True)
    contact_id: Mapped[str] = mapped_column(ForeignKey("contact_points.id"), nullable=True)

    @property
    def outcome(self) -> DeliveryState:
        """The state of the delivery."""
        if self.state is WorkState.DONE:
            return DeliveryState.SENT
        return DeliveryState.GIVEN_UP if self.state.is_final else DeliveryState.WAITING
