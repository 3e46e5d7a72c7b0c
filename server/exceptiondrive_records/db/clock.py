"""The database's clock, the only one that leases and quotas use."""

from datetime import UTC, datetime, timedelta
from typing import Any

from sqlalchemy import ColumnElement, Double, Function, func, literal_column, select
from sqlalchemy.ext.compiler import compiles
from sqlalchemy.orm import Session
from sqlalchemy.sql.compiler import SQLCompiler
from sqlalchemy.sql.functions import GenericFunction

from exceptiondrive_records.db.columns import UtcDateTime

Moment = datetime | ColumnElement[datetime]
"""A time in a condition: a known value, or `NOW`."""
_POSTGRESQL_NOW = select(func.clock_timestamp())


class seconds_from_now(GenericFunction[datetime]):  # noqa: N801 - it is called in statements
    """SQL expression: the start time of the statement plus some seconds.

    It needs no extra round trip, and statements that use it can be cached.
    """

    type = UtcDateTime()
    inherit_cache = True


class seconds_since(GenericFunction[float]):  # noqa: N801
    """SQL expression: the seconds from a column's time to the start time of the statement."""

    type = Double()
    inherit_cache = True


NOW = seconds_from_now(literal_column("0"))
"""SQL expression: the start time of the statement."""
SET_BACK = seconds_from_now(literal_column("60"))
"""Claims and marks later than this predate a setting back of the clock, and are no longer valid."""


@compiles(seconds_from_now)
def _postgres_later(element: Function[datetime], compiler: SQLCompiler, **how: Any) -> str:
    seconds = compiler.process(element.clauses, **how)
    return f"(statement_timestamp() + make_interval(secs => {seconds}))"


@compiles(seconds_from_now, "sqlite")
def _later_in_sqlite(element: Function[datetime], compiler: SQLCompiler, **how: Any) -> str:
    seconds = compiler.process(element.clauses, **how)
    return f"strftime('%Y-%m-%d %H:%M:%f000', 'now', printf('%f seconds', {seconds}))"


@compiles(seconds_since)
def _postgres_passed(element: Function[float], compiler: SQLCompiler, **how: Any) -> str:
    since = compiler.process(element.clauses, **how)
    return f"extract(epoch FROM statement_timestamp() - {since})"


@compiles(seconds_since, "sqlite")
def _passed_in_sqlite(element: Function[float], compiler: SQLCompiler, **how: Any) -> str:
    since = compiler.process(element.clauses, **how)
    return f"round((julianday('now') - julianday({since})) * 86400, 3)"


def database_now(session: Session) -> datetime:
    """Return the time of the database's clock, aware UTC.

    SQLite runs in this process and uses this machine's clock, in whole milliseconds.
    """
    if session.get_bind().dialect.name == "sqlite":
        here = datetime.now(UTC)
        return here.replace(microsecond=here.microsecond // 1000 * 1000)
    now = session.scalar(_POSTGRESQL_NOW)
    assert isinstance(now, datetime)
    return now.astimezone(UTC)


def start_of_day(now: datetime) -> datetime:
    """Return 00:00 UTC of the day of `now`."""
    return now.astimezone(UTC).replace(hour=0, minute=0, second=0, microsecond=0)


def next_day(now: datetime) -> datetime:
    """Return 00:00 UTC of the day after `now`, when daily quotas reset."""
    return start_of_day(now) + timedelta(days=1)
