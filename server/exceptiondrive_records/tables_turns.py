"""The table of turns: when each team was last served."""

from datetime import datetime

from sqlalchemy import ForeignKey
from sqlalchemy.orm import Mapped, mapped_column

from exceptiondrive_records.tables import Base


class TeamTurn(Base):
    """When a worker last took a live job of a team; who never had one has no row."""

    __tablename__ = "team_turns"
    team_id: Mapped[int] = mapped_column(ForeignKey("teams.id"), primary_key=True)
    served_at: Mapped[datetime]
