"""What workers found when they compared submissions with each other: sums over samples alone."""

from datetime import datetime

from sqlalchemy import ForeignKey, Text
from sqlalchemy.orm import Mapped, mapped_column

from exceptiondrive_records.db.base import Base


class SimilarityRow(Base):
    """A submission that was compared with all that were compared before it."""

    __tablename__ = "similarities"
    submission_id: Mapped[str] = mapped_column(ForeignKey("submissions.id"), primary_key=True)
    alike: Mapped[str] = mapped_column(Text)
    """`ALIKE_SUBMISSIONS` as JSON: the nearest of other teams, and of its own."""
    compared_at: Mapped[datetime]
