"""The tables of participation."""

from datetime import datetime

from sqlalchemy import ForeignKey, Text
from sqlalchemy.orm import Mapped, mapped_column

from exceptiondrive_records.db.base import Base


class Disqualification(Base):
    """A team, or one of its submissions, that stands on no board until it is reinstated."""

    __tablename__ = "disqualifications"
    id: Mapped[int] = mapped_column(primary_key=True)
    team_id: Mapped[int] = mapped_column(ForeignKey("teams.id"), index=True)
    phase_id: Mapped[str | None] = mapped_column(ForeignKey("phases.id"))
    """Where; None: in every phase."""
    submission_id: Mapped[str | None] = mapped_column(ForeignKey("submissions.id"))
    """None: everything of the team."""
    reason: Mapped[str] = mapped_column(Text)
    """Told to the team, and kept in the audit log."""
    public_note: Mapped[str | None] = mapped_column(Text)
    """What readers of the board are told; None: nothing."""
    disqualified_at: Mapped[datetime]
    reinstated_at: Mapped[datetime | None]


class Allowance(Base):
    """What one team is granted in a phase instead of what the phase gives to all."""

    __tablename__ = "allowances"
    team_id: Mapped[int] = mapped_column(ForeignKey("teams.id"), primary_key=True)
    phase_id: Mapped[str] = mapped_column(ForeignKey("phases.id"), primary_key=True)
    closes_at: Mapped[datetime | None]
    """A later deadline; None: that of the phase."""
    quota_per_day: Mapped[int | None]
    quota_total: Mapped[int | None]
    reason: Mapped[str] = mapped_column(Text)
    granted_at: Mapped[datetime]


class TermsAcceptance(Base):
    """That a team accepted one version of the terms of a phase."""

    __tablename__ = "terms_acceptances"
    team_id: Mapped[int] = mapped_column(ForeignKey("teams.id"), primary_key=True)
    phase_id: Mapped[str] = mapped_column(ForeignKey("phases.id"), primary_key=True)
    version: Mapped[str] = mapped_column(primary_key=True)
    """The first letters of the SHA-256 of the text."""
    accepted_at: Mapped[datetime]
    actor: Mapped[str]
