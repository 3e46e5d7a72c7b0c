"""The tables of notifications."""

from datetime import datetime
from enum import StrEnum

from sqlalchemy import ForeignKey, Index, Text, UniqueConstraint
from sqlalchemy.orm import Mapped, mapped_column

from exceptiondrive_records.db.base import Base
from exceptiondrive_records.db.columns import enum_text
from exceptiondrive_records.work.tables import WorkItem, WorkState


class Channel(StrEnum):
    """How a team is told besides its inbox."""

    WEBHOOK = "webhook"
    EMAIL = "email"


class DeliveryState(StrEnum):
    """Where a message to the outside stands."""

    WAITING = "waiting"
    SENT = "sent"
    GIVEN_UP = "given_up"


class ContactPoint(Base):
    """Where a team wants to be told besides its inbox."""

    __tablename__ = "contact_points"
    id: Mapped[str] = mapped_column(primary_key=True)
    team_id: Mapped[int] = mapped_column(ForeignKey("teams.id"), index=True)
    channel: Mapped[Channel] = mapped_column(enum_text(Channel))
    address: Mapped[str]
    secret: Mapped[str | None]
    """Signs the webhooks of this address, shown to the team once; of an e-mail address the key in
    the links that confirm it and unsubscribe it."""
    wishes: Mapped[str] = mapped_column(default="updates")
    """What it subscribes to: each a `Subscription`, separated by spaces."""
    confirmed_at: Mapped[datetime | None]
    """When whoever reads there said yes; a webhook needs no word."""
    created_at: Mapped[datetime]
    removed_at: Mapped[datetime | None]
    mailbox_digest: Mapped[str | None] = mapped_column(index=True)
    """Of an e-mail address, however it is written: says how often it was asked, and that it said no."""
    unsubscribed_at: Mapped[datetime | None]
    """When whoever reads there said no: the address goes then, as it does once it is removed, and the
    digest stays. None again once they took it back."""


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
    """What it is about, where nothing of the kind is told twice: a submission, a phase, an hour."""
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
