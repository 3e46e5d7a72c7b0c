"""The one clock that leases and quotas know: the database's."""

from datetime import UTC, datetime, timedelta

from sqlalchemy import ColumnElement, bindparam, func, select
from sqlalchemy.orm import Session

from exceptiondrive_records.db.columns import UtcDateTime

NOW = bindparam("now", type_=UtcDateTime())
"""The time in a statement that is made once, as making some takes longer than asking the database;
whoever sends it gives `{"now": database_now(session)}`."""
Moment = datetime | ColumnElement[datetime]
"""A time in a condition: one that is known, or `NOW`."""
_SQLITE_NOW = select(func.strftime("%Y-%m-%dT%H:%M:%f", "now"))
_POSTGRESQL_NOW = select(func.clock_timestamp())


def database_now(session: Session) -> datetime:
    """Return the time of the database's own clock, aware UTC."""
    if session.get_bind().dialect.name == "sqlite":
        text = session.scalar(_SQLITE_NOW)
        assert text is not None
        return datetime.fromisoformat(text).replace(tzinfo=UTC)
    now = session.scalar(_POSTGRESQL_NOW)
    assert isinstance(now, datetime)
    return now.astimezone(UTC)


def start_of_day(now: datetime) -> datetime:
    """Return 00:00 UTC of the day of `now`."""
    return now.astimezone(UTC).replace(hour=0, minute=0, second=0, microsecond=0)


def next_day(now: datetime) -> datetime:
    """Return 00:00 UTC of the day after `now`: when daily quotas begin anew."""
    return start_of_day(now) + timedelta(days=1)
