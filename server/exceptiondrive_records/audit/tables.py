"""The tables of audit."""

from datetime import datetime
from typing import Any

from sqlalchemy.orm import Mapped, mapped_column

from exceptiondrive_records.db.base import Base


class AuditLine(Base):
    """A line of the audit log: who did what; append-only and hash-chained."""

    __tablename__ = "audit_lines"
    id: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    at: Mapped[datetime]
    actor: Mapped[str]
    action: Mapped[str]
    subject: Mapped[str] = mapped_column(index=True)
    detail: Mapped[dict[str, Any]]
    previous_hash: Mapped[str]
    hash: Mapped[str]
