"""The declarative base of all tables."""

from datetime import datetime
from typing import Any

from sqlalchemy import JSON, String
from sqlalchemy.orm import DeclarativeBase

from exceptiondrive_records.db.columns import UtcDateTime, enum_text
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.jobs import Lane


class Base(DeclarativeBase):
    """Column types common to all tables."""

    type_annotation_map = {  # noqa: RUF012 - SQLAlchemy reads it once
        datetime: UtcDateTime(),
        SubmissionStatus: enum_text(SubmissionStatus),
        Lane: enum_text(Lane),
        dict[str, Any]: JSON(),
        dict[str, int]: JSON(),
        list[str]: JSON(),
        str: String(),
    }
