"""Engine for PostgreSQL over a network that saves round trips: one for each needed result.

Imported only for a PostgreSQL address: the driver takes a twelfth of a command's start-up time.
"""

import select
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import psycopg
from psycopg.pq import TransactionStatus
from sqlalchemy import Connection, Engine, create_engine, event
from sqlalchemy.engine.interfaces import DBAPIConnection
from sqlalchemy.exc import DBAPIError, InvalidatePoolError
from sqlalchemy.pool import ConnectionPoolEntry

from exceptiondrive_records.db.last import WRITES

TRUSTED_FOR_S = 5.0
"""A connection used within so many seconds is not pinged if its socket has nothing to read. If the
server had closed it, there would be something to read."""
BEGIN = "BEGIN"
_GIVEN_BACK = "exceptiondrive_given_back_s"
_LOST_AFTER_30_S = {"tcp_user_timeout": 30_000, "keepalives_idle": 10, "keepalives_interval": 5}
"""A lost machine or network is noticed within 30 s; a stopped server is not: its kernel answers."""
_LOCK_TIMEOUT = "30s"


def postgresql_engine(url: str) -> Engine:
    """Return an engine that pings connections before use if they may be broken."""
    engine = create_engine(
        url,
        pool_size=5,
        max_overflow=20,
        connect_args={
            "options": f"-c timezone=UTC -c lock_timeout={_LOCK_TIMEOUT}",
            "connect_timeout": 5,
            **_LOST_AFTER_30_S,
        },
    )

    def note_when(connection: DBAPIConnection | None, entry: ConnectionPoolEntry) -> None:
        entry.info[_GIVEN_BACK] = time.monotonic()

    def ask_if_in_doubt(connection: Any, entry: ConnectionPoolEntry, _: Any) -> None:
        given_back_s = entry.info.pop(_GIVEN_BACK, None)
        if given_back_s is None or _is_trusted(connection, given_back_s):
            return
        try:
            engine.dialect.do_ping(connection)
        except psycopg.Error:
            raise InvalidatePoolError from None  # the pool opens a new one

    event.listen(engine, "connect", _refuse_pooler)
    event.listen(engine, "checkin", note_when)
    event.listen(engine, "checkout", ask_if_in_doubt)
    event.listen(engine, "do_execute", partial(_begin_with, "execute"))
    event.listen(engine, "do_executemany", partial(_begin_with, "executemany"))
    return engine


def _refuse_pooler(connection: Any, _: ConnectionPoolEntry) -> None:
    """Refuse a pooler in transaction mode: it drops settings and mixes up prepared statements."""
    connection.autocommit = True
    (kept,) = connection.execute("SHOW lock_timeout").fetchone()
    connection.autocommit = False
    if kept != _LOCK_TIMEOUT:
        connection.close()
        raise psycopg.OperationalError(
            "a pooler such as PgBouncer stands before it and drops settings; name PostgreSQL itself"
        )


def _is_trusted(connection: "psycopg.Connection[Any]", given_back_s: float) -> bool:
    if connection.closed or time.monotonic() > given_back_s + TRUSTED_FOR_S:
        return False
    heard = select.poll()
    heard.register(connection.fileno(), select.POLLIN)
    return not heard.poll(0)


def _begin_with(how: str, cursor: Any, statement: Any, parameters: Any, context: Any) -> bool:
    if not _must_begin(cursor, context):
        return False
    with cursor.connection.pipeline():
        cursor.connection.execute(BEGIN)
        getattr(cursor, how)(statement, parameters)
    return True


def _must_begin(cursor: Any, context: Any) -> bool:
    """Whether this is the first statement of a write transaction, with which BEGIN is sent.

    Reading row by row (a server-side cursor) needs a transaction as well, which is begun here.
    """
    connection = cursor.connection
    if not connection.autocommit or has_begun(connection):
        return False
    if isinstance(cursor, psycopg.ServerCursor):
        connection.execute(BEGIN)
        return False
    return bool(context.root_connection.get_execution_options().get(WRITES))


def has_begun(driver: "psycopg.Connection[Any]") -> bool:
    """Whether a transaction is open, or is being opened."""
    return driver.info.transaction_status != TransactionStatus.IDLE


@contextmanager
def in_one_go(connection: Connection) -> Iterator["psycopg.Connection[Any]"]:
    """Pipeline the statements executed inside and the commit, without waiting for results in between.

    The first error is raised at the end, and the transaction is then rolled back.

    Raises:
        DBAPIError: As for a single statement.
    """
    driver: psycopg.Connection[Any] = connection.connection.driver_connection  # type: ignore[assignment]
    try:
        with driver.pipeline():
            if not has_begun(driver):
                driver.execute(BEGIN)
            yield driver
            driver.execute("COMMIT")
    except psycopg.Error as error:
        if driver.closed:
            connection.invalidate(error)
        raise DBAPIError.instance(
            None, None, error, psycopg.Error, dialect=connection.dialect
        ) from error
