"""Insertions that may meet a row that is there already, in the words of either database."""

from collections.abc import Collection, Mapping
from typing import Any

from sqlalchemy.dialects.postgresql import insert as postgres_insert
from sqlalchemy.dialects.sqlite import insert as sqlite_insert
from sqlalchemy.orm import Session

from exceptiondrive_records.db.base import Base


def insert_if_absent(session: Session, table: type[Base], **values: Any) -> None:
    """Insert a row, unless one of the same key is there."""
    session.execute(_insert(session)(table).values(**values).on_conflict_do_nothing())


def upsert(
    session: Session,
    table: type[Base],
    values: Mapping[str, Any],
    changes: Mapping[str, Any],
    *,
    keys: Collection[str] = (),
) -> None:
    """Insert a row; where one of the same keys is there, change that one instead.

    Args:
        session: Of a write transaction.
        table: Which.
        values: Of the new row.
        changes: Of the one that is there.
        keys: What is unique; by default the primary key.
    """
    keys = keys or [column.name for column in table.__table__.primary_key]
    new = _insert(session)(table).values(**values)
    session.execute(new.on_conflict_do_update(index_elements=list(keys), set_=changes))


def _insert(session: Session) -> Any:
    return sqlite_insert if session.get_bind().dialect.name == "sqlite" else postgres_insert
