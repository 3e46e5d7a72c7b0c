"""The tables of teams."""

from datetime import datetime
from typing import Any

from sqlalchemy import CheckConstraint, ForeignKey
from sqlalchemy.orm import Mapped, mapped_column

from exceptiondrive_records.db.base import Base
from exceptiondrive_records.db.errors import Conflict
from exceptiondrive_records.db.identifiers import skeleton


class Team(Base):
    """Owns submissions."""

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
    """The name as an eye reads it: no two teams stand on a board under the same one."""
    affiliation: Mapped[str] = mapped_column(default="")
    """Where its people work or study, for organizers alone."""
    is_reference: Mapped[bool]
    created_at: Mapped[datetime]
    pending_since: Mapped[datetime | None]
    """Registered itself then, and submits nothing until an organizer approves."""
    registration_note: Mapped[str | None]
    """Who they say they are, for organizers."""
    forgotten_at: Mapped[datetime | None]
    """Since then its name is an alias, told of it on every board, and nothing personal is kept."""
    merged_into_id: Mapped[int | None] = mapped_column(
        ForeignKey("teams.id", deferrable=True, initially="DEFERRED")
    )
    """The team that it became part of, with all that it sent."""
    registered_from: Mapped[str | None]
    """Digest of the network that it registered itself from, until it is approved."""

    @property
    def is_gone(self) -> bool:
        """Whether it was forgotten or became part of another team: nobody acts or reads for it."""
        return self.forgotten_at is not None or self.merged_into_id is not None

    def require_there(self) -> None:
        """Refuse what would let somebody act for a team that is gone.

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
