"""The base of all tables: column types that they have in common."""

from datetime import datetime
from enum import StrEnum
from typing import Any

from sqlalchemy import JSON, String
from sqlalchemy.orm import DeclarativeBase

from exceptiondrive_records.db.columns import UtcDateTime, enum_text
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_schemas.submission import SubmissionStatus


class JobState(StrEnum):
    """Where a job stands. The last four are final."""

    QUEUED = "queued"
    LEASED = "leased"
    DONE = "done"
    FAILED = "failed"
    DEAD = "dead"
    """Every attempt ended without an answer."""
    CANCELLED = "cancelled"
    """The submission was withdrawn first."""

    @property
    def is_final(self) -> bool:
        """Whether the job has ended."""
        return self not in (JobState.QUEUED, JobState.LEASED)


class Base(DeclarativeBase):
    """Column types common to all tables."""

    type_annotation_map = {  # noqa: RUF012 - SQLAlchemy reads it once
        datetime: UtcDateTime(),
        SubmissionStatus: enum_text(SubmissionStatus),
        JobState: enum_text(JobState),
        Lane: enum_text(Lane),
        dict[str, Any]: JSON(),
        dict[str, int]: JSON(),
        list[str]: JSON(),
        str: String(),
    }
