"""The tables of protocols."""

from datetime import datetime

from sqlalchemy import Text
from sqlalchemy.orm import Mapped, mapped_column

from exceptiondrive_records.db.base import Base


class ProtocolRow(Base):
    """A protocol document, immutable."""

    __tablename__ = "protocols"
    digest: Mapped[str] = mapped_column(primary_key=True)
    version: Mapped[str] = mapped_column(unique=True)
    toml: Mapped[str] = mapped_column(Text)
    created_at: Mapped[datetime]
