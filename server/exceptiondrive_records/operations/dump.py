"""Dump all tables as portable JSON lines: from SQLite to PostgreSQL and back, bit for bit.

Documents keep their exact text. Rows about running processes only (heartbeats, leadership) are left
out: they mean nothing on another system.
"""

import json
from collections.abc import Iterable, Iterator
from datetime import datetime
from typing import Any

from sqlalchemy import (
    JSON,
    Column,
    ColumnElement,
    Enum,
    MetaData,
    Table,
    Text,
    func,
    select,
    text,
    true,
)
from sqlalchemy.orm import Session
from sqlalchemy.types import TypeEngine

from exceptiondrive_records.boards.tables import BoardRow
from exceptiondrive_records.db.base import Base
from exceptiondrive_records.db.columns import DocumentText, UtcDateTime
from exceptiondrive_records.submissions.submissions import keeps_its_file
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.work.tables import Leader, WorkerHeartbeat

BACKUP, BACKUP_WRITTEN, BACKUP_FAILED = "backup", "backup written", "backup failed"
"""Subject and actions of the audit lines of backups."""
_PASSING = {WorkerHeartbeat.__tablename__}
_LEADS = Leader.__mapper__.polymorphic_identity


def dumped_tables() -> list[Table]:
    """Return the tables of a dump, referenced ones before those that refer to them."""
    return [table for table in Base.metadata.sorted_tables if table.name not in _PASSING]


def begin_snapshot(session: Session) -> None:
    """Make all reads of this session see one snapshot; call it first."""
    if session.get_bind().dialect.name == "postgresql":
        session.connection(execution_options={"isolation_level": "REPEATABLE READ"})
    else:
        session.connection()  # a read transaction of SQLite is a snapshot


def dump_rows(session: Session, table: Table) -> Iterator[str]:
    """Yield one line of JSON for each row."""
    plain = _stored_columns(table)
    keys = [column.name for column in table.primary_key]
    query = select(plain).where(_is_portable(plain)).order_by(*(plain.c[key] for key in keys))
    for row in session.execute(query.execution_options(yield_per=_rows_at_once(table))):
        yield json.dumps([_to_json(value) for value in row], ensure_ascii=False, allow_nan=False)


def column_names(table: Table) -> list[str]:
    """Return the names of the values in a line."""
    return [column.name for column in table.columns]


def load_rows(session: Session, table: Table, lines: Iterable[str]) -> None:
    """Insert dumped rows into an empty table."""
    plain = _stored_columns(table)
    waiting: list[dict[str, Any]] = []
    for line in lines:
        values = zip(plain.columns, json.loads(line), strict=True)
        waiting.append({column.name: _from_json(column.type, value) for column, value in values})
        if len(waiting) == _rows_at_once(table):
            session.execute(plain.insert(), waiting)
            waiting = []
    if waiting:
        session.execute(plain.insert(), waiting)
    _set_sequence(session, table)


def is_empty(session: Session) -> bool:
    """Whether no table holds a row."""
    counts = (
        select(func.count()).select_from(table).where(_is_portable(table))
        for table in dumped_tables()
    )
    return not any(session.scalar(count) for count in counts)


def file_digests(
    session: Session, only: str | None = None, *, with_unconfirmed: bool = False
) -> list[str]:
    """Return the digests of all stored files that any table mentions, or of these only `only`.

    Submissions that their teams did not confirm in time are ignored, unless `with_unconfirmed`.
    """
    found: set[str] = set()
    for table in dumped_tables():
        for column in table.columns:
            if column.name.endswith("file_digest"):
                query = select(column).where(column.is_not(None)).distinct()
                if only is not None:
                    query = query.where(column == only)
                if table.name == Submission.__tablename__ and not with_unconfirmed:
                    query = query.where(keeps_its_file(session))
                found |= set(session.scalars(query))
    return sorted(found)


def _rows_at_once(table: Table) -> int:
    """Return how many rows to load at once: a board of 10,000 entries alone takes 44 MB."""
    return 1 if table.name == BoardRow.__tablename__ else 500


def _is_portable(table: Table) -> ColumnElement[bool]:
    """Whether a row is meaningful on another system: the present leader is not."""
    return table.c.kind != _LEADS if table.name == Leader.__tablename__ else true()


def _stored_columns(table: Table) -> Table:
    """Return the table with columns that yield stored values instead of parsed documents."""
    return Table(
        table.name,
        MetaData(),
        *(Column(column.name, _plain_type(column.type)) for column in table.columns),
    )


def _plain_type(kind: TypeEngine[Any]) -> TypeEngine[Any]:
    if isinstance(kind, DocumentText | Enum):
        return Text()
    return JSON(none_as_null=True) if isinstance(kind, JSON) else kind


def _to_json(value: Any) -> Any:
    return value.isoformat() if isinstance(value, datetime) else value


def _from_json(kind: TypeEngine[Any], value: Any) -> Any:
    is_time = isinstance(kind, UtcDateTime) and value is not None
    return datetime.fromisoformat(value) if is_time else value


def _set_sequence(session: Session, table: Table) -> None:
    """Make PostgreSQL's sequence continue after the last row."""
    if session.get_bind().dialect.name != "postgresql":
        return
    (key, *more) = table.primary_key.columns
    sequence = session.scalar(
        text("SELECT pg_get_serial_sequence(:table, :key)"), {"table": table.name, "key": key.name}
    )
    if sequence is None or more:
        return
    last = session.scalar(select(func.max(key)))
    if last is not None:
        session.execute(
            text("SELECT setval(:sequence, :last)"), {"sequence": sequence, "last": last}
        )
