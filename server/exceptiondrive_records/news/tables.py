"""The tables of news and questions."""

from datetime import datetime

from sqlalchemy import ForeignKey, Text
from sqlalchemy.orm import Mapped, mapped_column

from exceptiondrive_records.db.base import Base


class News(Base):
    """An announcement of organizers about a phase."""

    __tablename__ = "news"
    id: Mapped[str] = mapped_column(primary_key=True)
    phase_id: Mapped[str] = mapped_column(ForeignKey("phases.id", ondelete="CASCADE"), index=True)
    title: Mapped[str]
    text: Mapped[str] = mapped_column(Text)
    """Markdown."""
    published_at: Mapped[datetime]
    withdrawn_at: Mapped[datetime | None]
    """When it was withdrawn; readers no longer see it."""


class Question(Base):
    """A team's question to the organizers, and their answer."""

    __tablename__ = "questions"
    id: Mapped[str] = mapped_column(primary_key=True)
    phase_id: Mapped[str] = mapped_column(ForeignKey("phases.id"))
    team_id: Mapped[int] = mapped_column(ForeignKey("teams.id"), index=True)
    text: Mapped[str] = mapped_column(Text)
    asked_at: Mapped[datetime]
    answer: Mapped[str | None] = mapped_column(Text)
    answered_at: Mapped[datetime | None]
    news_id: Mapped[str | None] = mapped_column(ForeignKey("news.id"))
    """The news that publish the answer without the team's name; None if only the team got it."""
