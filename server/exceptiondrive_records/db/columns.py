"""Column types that behave alike on SQLite and PostgreSQL, and a condition on one of them."""

from collections.abc import Iterable
from datetime import UTC, datetime
from enum import StrEnum
from typing import Any, Generic, TypeVar

from sqlalchemy import ColumnElement, DateTime, Dialect, Enum, Text, literal
from sqlalchemy.orm import InstrumentedAttribute
from sqlalchemy.types import TypeDecorator

from exceptiondrive_schemas.base import Document, canonical_json

SomeDocument = TypeVar("SomeDocument", bound=Document)
SomeEnum = TypeVar("SomeEnum", bound=StrEnum)


class UtcDateTime(TypeDecorator[datetime]):
    """A timezone-aware UTC time in Python, on both databases."""

    impl = DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        """Refuse naive times; SQLite stores UTC without a time zone."""
        if value is None:
            return None
        if value.tzinfo is None:
            raise ValueError("a recorded time must be aware: give it a time zone")
        utc = value.astimezone(UTC)
        return utc.replace(tzinfo=None) if dialect.name == "sqlite" else utc

    def process_result_value(self, value: Any, dialect: Dialect) -> datetime | None:
        """Return the time in UTC."""
        if value is None:
            return None
        assert isinstance(value, datetime)
        return value.replace(tzinfo=UTC) if value.tzinfo is None else value.astimezone(UTC)


class DocumentText(TypeDecorator[SomeDocument], Generic[SomeDocument]):
    """A document of `exceptiondrive_schemas`, stored as canonical JSON."""

    impl = Text
    cache_ok = True

    def __init__(self, model: type[SomeDocument]) -> None:
        super().__init__()
        self.model = model

    def process_bind_param(self, value: SomeDocument | None, dialect: Dialect) -> str | None:
        """Write canonical JSON."""
        return None if value is None else canonical_json(value).decode("utf-8")

    def process_result_value(self, value: Any, dialect: Dialect) -> SomeDocument | None:
        """Parse and validate; a process of a newer version may have written it."""
        return None if value is None else self.model.read(value)


def is_one_of(
    column: InstrumentedAttribute[SomeEnum], values: Iterable[SomeEnum]
) -> ColumnElement[bool]:
    """Condition for a cached statement: a plain `in_` list is compiled again at each execution."""
    return column.in_([literal(value, column.type) for value in values])


def enum_text(values: type[StrEnum]) -> Enum:
    """Return a column type that stores the values of an enum as text."""
    return Enum(
        values,
        native_enum=False,
        create_constraint=False,
        length=16,
        values_callable=lambda members: [member.value for member in members],
    )
