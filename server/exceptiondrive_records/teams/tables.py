"""The tables of teams."""

from datetime import datetime
from typing import Any

from sqlalchemy import CheckConstraint, ForeignKey
from sqlalchemy.orm import Mapped, mapped_column

from exceptiondrive_records.db.base import Base
from exceptiondrive_records.db.errors import Conflict
from exceptiondrive_records.db.identifiers import skeleton


class Team(Base):
    """A team, which owns submissions."""

    __tablename__ = "teams"
    __table_args__ = (
        CheckConstraint("forgotten_at IS NULL OR name LIKE 'Former team ______'", "ck_former"),
    )
    id: Mapped[int] = mapped_column(primary_key=True)
    slug: Mapped[str] = mapped_column(unique=True)
    name: Mapped[str] = mapped_column(unique=True)
    name_skeleton: Mapped[str] = mapped_column(
        unique=True, default=lambda made: skeleton(made.get_current_parameters()["name"])
    )
    """The skeleton of the name: unique, so that no two teams have names that look alike."""
    affiliation: Mapped[str] = mapped_column(default="")
    """Where its people work or study; only organizers see it."""
    is_reference: Mapped[bool]
    created_at: Mapped[datetime]
    pending_since: Mapped[datetime | None]
    """When it registered itself; set until an organizer approves it, which lets it submit."""
    registration_note: Mapped[str | None]
    """Who they say they are; only organizers see it."""
    forgotten_at: Mapped[datetime | None]
    """When it was forgotten: since then its name is an alias, and personal data is deleted."""
    merged_into_id: Mapped[int | None] = mapped_column(
        ForeignKey("teams.id", deferrable=True, initially="DEFERRED")
    )
    """The team into which it was merged, with all of its submissions."""
    registered_from: Mapped[str | None]
    """Digest of the network from which it registered itself; kept until it is approved."""

    @property
    def is_gone(self) -> bool:
        """Whether it was forgotten or merged into another team: nobody acts or reads for it."""
        return self.forgotten_at is not None or self.merged_into_id is not None

    def require_there(self) -> None:
        """Refuse an action for a team that is gone.

        Raises:
            Conflict: It is gone.
        """
        if self.is_gone:
            gone = "was forgotten" if self.forgotten_at is not None else "is part of another one"
            raise Conflict(f"The team {self.slug} {gone}: nobody acts for it any more.")


class SiteSetting(Base):
    """A setting that organizers switch while the server runs."""

    __tablename__ = "site_settings"
    name: Mapped[str] = mapped_column(primary_key=True)
    value: Mapped[dict[str, Any]]
    changed_at: Mapped[datetime]
