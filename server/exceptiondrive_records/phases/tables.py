"""The tables of phases."""

from datetime import datetime

from sqlalchemy import ForeignKey, ForeignKeyConstraint, String, Text
from sqlalchemy.orm import Mapped, mapped_column

from exceptiondrive_records.db.base import Base
from exceptiondrive_records.db.columns import DocumentText
from exceptiondrive_schemas.api.phase_settings import PhasePage, PhasePolicy, Visibility
from exceptiondrive_schemas.challenges import ChallengeId


class Phase(Base):
    """A dated stage of a challenge."""

    __tablename__ = "phases"
    __table_args__ = (
        ForeignKeyConstraint(["split_name", "split_revision"], ["splits.name", "splits.revision"]),
    )
    id: Mapped[str] = mapped_column(primary_key=True)
    challenge: Mapped[ChallengeId] = mapped_column(String)
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
    """How many submissions of a team may wait for their score at once."""
    rejected_per_day: Mapped[int]
    current_board_id: Mapped[int | None]
    shows_reported: Mapped[bool]
    created_at: Mapped[datetime]
    visibility: Mapped[Visibility] = mapped_column(String)
    position: Mapped[int | None]
    """The phase with the lowest one is first in lists, and on the front page."""
    page: Mapped[PhasePage] = mapped_column(DocumentText(PhasePage), default=PhasePage())
    policy: Mapped[PhasePolicy] = mapped_column(DocumentText(PhasePolicy), default=PhasePolicy())
    unfrozen_at: Mapped[datetime | None]
    names_revealed_at: Mapped[datetime | None]
    pseudonym_salt: Mapped[str | None] = mapped_column(deferred=True)
    """The random key of the pseudonyms. Never shown to anyone."""
    late_board_id: Mapped[int | None]
    """The board of the late view."""
