"""The tables of work."""

from datetime import datetime

from sqlalchemy.orm import Mapped, mapped_column

from exceptiondrive_records.db.base import Base


class WorkerHeartbeat(Base):
    """The last sign of life of a worker."""

    __tablename__ = "worker_heartbeats"
    worker_id: Mapped[str] = mapped_column(primary_key=True)
    at: Mapped[datetime]
    lanes: Mapped[list[str]]
    slots: Mapped[int]
    scorer_version: Mapped[str | None]
    """Whose scores it makes; None: a release that did not say."""
