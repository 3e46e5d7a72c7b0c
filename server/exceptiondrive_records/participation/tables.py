"""The tables of participation."""

from datetime import datetime

from sqlalchemy import ForeignKey, Text
from sqlalchemy.orm import Mapped, mapped_column

from exceptiondrive_records.db.base import Base


class Disqualification(Base):
    """The exclusion of a team, or of one of its submissions, from boards until it is reinstated."""

    __tablename__ = "disqualifications"
    id: Mapped[int] = mapped_column(primary_key=True)
    team_id: Mapped[int] = mapped_column(ForeignKey("teams.id"), index=True)
    phase_id: Mapped[str | None] = mapped_column(ForeignKey("phases.id"))
    """The phase; None for every phase."""
    submission_id: Mapped[str | None] = mapped_column(ForeignKey("submissions.id"))
    """The submission; None for everything of the team."""
    reason: Mapped[str] = mapped_column(Text)
    """Shown to the team, and kept in the audit log."""
    public_note: Mapped[str | None] = mapped_column(Text)
    """The note shown to readers of the board; None if there is none."""
    disqualified_at: Mapped[datetime]
    reinstated_at: Mapped[datetime | None]


class Allowance(Base):
    """Limits of one team in a phase, which replace those of the phase."""

    __tablename__ = "allowances"
    team_id: Mapped[int] = mapped_column(ForeignKey("teams.id"), primary_key=True)
    phase_id: Mapped[str] = mapped_column(ForeignKey("phases.id"), primary_key=True)
    closes_at: Mapped[datetime | None]
    """A later deadline; None for that of the phase."""
    quota_per_day: Mapped[int | None]
    quota_total: Mapped[int | None]
    reason: Mapped[str] = mapped_column(Text)
    granted_at: Mapped[datetime]


class TermsAcceptance(Base):
    """The acceptance of one version of the terms of a phase by a team."""

    __tablename__ = "terms_acceptances"
    team_id: Mapped[int] = mapped_column(ForeignKey("teams.id"), primary_key=True)
    phase_id: Mapped[str] = mapped_column(ForeignKey("phases.id"), primary_key=True)
    version: Mapped[str] = mapped_column(primary_key=True)
    """The first letters of the SHA-256 of the text."""
    accepted_at: Mapped[datetime]
    actor: Mapped[str]
