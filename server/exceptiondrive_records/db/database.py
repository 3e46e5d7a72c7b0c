"""Sessions on the system of record: short reads, and one write transaction at a time.

SQLite: WAL, synchronous=FULL, and `BEGIN IMMEDIATE` for every write, because the busy timeout is
not honoured when a read transaction is upgraded (docs/decisions/0003-sql-is-the-queue.md).
"""

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, TypeVar

from sqlalchemy import (
    Connection,
    Engine,
    Executable,
    Select,
    bindparam,
    create_engine,
    event,
    func,
    make_url,
    select,
    text,
)
from sqlalchemy.dialects.postgresql import insert as postgres_insert
from sqlalchemy.dialects.sqlite import insert as sqlite_insert
from sqlalchemy.engine.interfaces import DBAPIConnection
from sqlalchemy.exc import DataError, DBAPIError, IntegrityError, OperationalError
from sqlalchemy.orm import Session, sessionmaker
from sqlalchemy.orm.exc import StaleDataError
from sqlalchemy.orm.util import identity_key

from exceptiondrive_records.audit.log import chain_audit_lines, chain_in_sql, take_audit_lines
from exceptiondrive_records.db.base import Base
from exceptiondrive_records.db.errors import Conflict, NotFound
from exceptiondrive_records.db.last import WRITES, take_last

Row = TypeVar("Row", bound=Base)
BUSY_TIMEOUT_MS = 15_000
_AUTOCOMMIT = "AUTOCOMMIT"
_BY_ITSELF = {"isolation_level": _AUTOCOMMIT}
_FOR_ONE_BLOCK: dict[str, Any] = {"expire_on_commit": False, "close_resets_only": False}
"""Loaded objects stay readable after the block; later queries fail, and leak no connection."""
_INSUFFICIENT_PRIVILEGE = "42501"
_DIVISION_BY_ZERO = "22012"
_UNDEFINED_TABLE = "42P01"
_UNDEFINED_COLUMN = "42703"
_CONFLICTS = {
    "23503",
    "23505",
    "SQLITE_CONSTRAINT_FOREIGNKEY",
    "SQLITE_CONSTRAINT_PRIMARYKEY",
    "SQLITE_CONSTRAINT_UNIQUE",
}
_DAMAGED = {"XX001", "XX002", "SQLITE_CORRUPT", "SQLITE_NOTADB"}
_NO_TABLE = "no such table"  # SQLite has no error code for it
_NO_COLUMN = "no such column"


class Database:
    """Provides sessions. Safe to share between threads, not between forked processes."""

    def __init__(self, url: str) -> None:
        self.engine = _engine(url)
        is_server = self.engine.dialect.name == "postgresql"
        reads = self.engine.execution_options(**_BY_ITSELF) if is_server else self.engine
        self._reads = sessionmaker(reads, class_=_Session, **_FOR_ONE_BLOCK)
        event.listen(self._reads, "before_flush", _refuse_to_write)
        writes = reads.execution_options(**{WRITES: True})
        self._writes = sessionmaker(writes, class_=_Session, **_FOR_ONE_BLOCK)
        self._claims = sessionmaker(reads if is_server else writes, **_FOR_ONE_BLOCK)

    @contextmanager
    def read(self) -> Iterator[Session]:
        """Return a session for reading.

        SQLite reads in one transaction. PostgreSQL runs in autocommit: each statement sees what is
        committed when it starts, as under READ COMMITTED, without round trips to begin and end one.

        Raises:
            RuntimeError: An object was added, changed or deleted.
        """
        with self._reads() as session:
            yield session

    @contextmanager
    def write(self) -> Iterator[Session]:
        """Return a session for ONE write transaction, which is committed entirely or not at all."""
        with self._writes() as session, session.begin():
            yield session
            session.flush()
            _end_transaction(session)

    @contextmanager
    def claim(self) -> Iterator[Session]:
        """Return a session for ONE statement: like `write`, without audit lines.

        PostgreSQL commits it at once, so that claimed rows are not locked during a round trip.
        """
        with self._claims() as session, session.begin():
            yield session

    def takes_writes(self) -> bool:
        """Whether rows can be added: not on a standby, nor in a file read-only for owner or user.

        Raises:
            SQLAlchemyError: The database does not answer.
        """
        if self.engine.dialect.name == "postgresql":
            with self.read() as session:
                return bool(session.scalar(text("SHOW transaction_read_only")) == "off")
        path = Path(self.engine.url.database or "")
        if not (os.access(path, os.W_OK) and os.access(path.parent, os.W_OK)):
            return False  # checked first: in an inaccessible folder, `stat` of the file fails
        return bool(path.stat().st_mode & stat.S_IWUSR)  # root may write even a read-only file

    def dispose(self) -> None:
        """Close all connections."""
        self.engine.dispose()


class _Session(Session):
    """Caches the statement of `get` for each table: building it takes longer than running it."""

    def get(self, entity: Any, ident: Any, **how: Any) -> Any:
        """As `Session.get`: objects already loaded are not queried again."""
        keys = ident if isinstance(ident, tuple) else (ident,)
        if any(how.values()) or identity_key(entity, keys) in self.identity_map:
            return super().get(entity, ident, **how)
        names = (column.name for column in entity.__mapper__.primary_key)
        return self.scalars(_by_key(entity), dict(zip(names, keys, strict=True))).first()


@cache
def _by_key(kind: type[Base]) -> Select[Any]:
    keys = kind.__mapper__.primary_key
    return select(kind).where(*(column == bindparam(column.name) for column in keys))


def _end_transaction(session: Session) -> None:
    """Run deferred statements and chain the audit lines; on PostgreSQL commit in the same round trip.

    On PostgreSQL the batch must abort itself if a condition fails, so a failed one divides by zero.
    """
    last, lines = take_last(session), take_audit_lines(session)
    if not last and not lines:
        return
    connection = session.connection()
    if connection.dialect.name == "sqlite":
        for each in last:
            found = connection.execute(each.what, each.given)
            if each.refusal is not None and not found.scalar():
                raise each.refusal
        chain_audit_lines(session, lines)
        return
    from exceptiondrive_records.db.postgresql import in_one_go

    refusal = next((each.refusal for each in last if each.refusal is not None), None)
    try:
        with in_one_go(connection) as driver:
            for each in last:
                connection.execute(each.what, each.given)
            chain_in_sql(driver, lines)
    except DataError as error:
        if refusal is None or _code_of(error) != _DIVISION_BY_ZERO:
            raise
        raise refusal from None


def _refuse_to_write(session: Session, *_: Any) -> None:
    raise RuntimeError("this session reads: nothing may be changed in it")


def sentence_of(error: DBAPIError) -> str:
    """Describe a database's error and what an operator can do about it, without the statement.

    Raises:
        DBAPIError: The error itself, if it is neither an outage, damage, nor a missing right, table
            or column.
    """
    said = str(error.orig).partition("\n")[0]
    if said.startswith(_NO_TABLE) or _code_of(error) == _UNDEFINED_TABLE:
        return (
            f"{said}; nothing is set up in this database yet: start the server with it, run "
            "exceptiondrive-server migrate, or name another in EXCEPTIONDRIVE_DATABASE_URL"
        )
    if _lacks_column(error):
        return f"{said}; another version made these records: exceptiondrive-server doctor says more"
    if _code_of(error) == _INSUFFICIENT_PRIVILEGE:
        return f"{said}; its owner gives the rights: exceptiondrive-server migrate --grant-to FILE"
    if _code_of(error) in _DAMAGED:
        return f"{said}; the records are damaged: restore a backup into new ones"
    if isinstance(error, OperationalError):
        return f"the database does not answer: {said}"
    raise error


def reason_of(error: BaseException) -> dict[str, str]:
    """Return the `reason` of a log line for a database error, if an operator can act on it."""
    if isinstance(error, DBAPIError):
        with suppress(DBAPIError):
            return {"reason": sentence_of(error)}
    return {}


def is_conflict(error: Exception) -> bool:
    """Whether another transaction took the same key, or deleted a changed or referred row."""
    return isinstance(error, StaleDataError) or _code_of(error) in _CONFLICTS


def is_forbidden(error: Exception) -> bool:
    """Whether a right or column is missing, or a constraint is violated: retrying does not help."""
    is_ruled = isinstance(error, IntegrityError) or _code_of(error) == _INSUFFICIENT_PRIVILEGE
    return is_ruled or _lacks_column(error)


def _lacks_column(error: Exception) -> bool:
    said = str(getattr(error, "orig", None))
    return _code_of(error) == _UNDEFINED_COLUMN or said.startswith(_NO_COLUMN)


def _code_of(error: Exception) -> str | None:
    """Return the SQLSTATE of PostgreSQL, or SQLite's name of the error."""
    said = getattr(error, "orig", None)
    return getattr(said, "sqlstate", None) or getattr(said, "sqlite_errorname", None)


def _engine(url: str) -> Engine:
    if make_url(url).get_backend_name() == "sqlite":
        return _sqlite_engine(url)
    from exceptiondrive_records.db.postgresql import postgresql_engine

    return postgresql_engine(url)


def _sqlite_engine(url: str) -> Engine:
    path = make_url(url).database
    if path is None or path in ("", ":memory:"):
        raise ValueError("SQLite needs a file: several processes share the records")
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    engine = create_engine(url, connect_args={"timeout": BUSY_TIMEOUT_MS / 1000})
    event.listen(engine, "connect", _prepare_sqlite)
    event.listen(engine, "begin", _begin_sqlite)
    return engine


def _prepare_sqlite(connection: DBAPIConnection, record: Any) -> None:
    connection.isolation_level = None  # the driver opens no transaction; `_begin_sqlite` does
    cursor = connection.cursor()
    cursor.execute(f"PRAGMA busy_timeout={BUSY_TIMEOUT_MS}")
    cursor.execute("PRAGMA journal_mode=WAL")
    cursor.execute("PRAGMA synchronous=FULL")
    cursor.execute("PRAGMA foreign_keys=ON")
    cursor.execute("PRAGMA secure_delete=ON")  # erase forgotten people from free pages as well
    cursor.close()


def _begin_sqlite(connection: Connection) -> None:
    if connection.get_execution_options().get("isolation_level") == _AUTOCOMMIT:
        return
    if connection.get_execution_options().get(WRITES, False):
        connection.exec_driver_sql("BEGIN IMMEDIATE")
    else:  # takes no lock, so cannot fail: bypass the engine's error handling
        driver: Any = connection.connection.driver_connection
        driver.execute("BEGIN")


# Insertions where the row may exist already, in the dialect of either database.


Changes = tuple[tuple[str, Any], ...]
"""Columns and their new values, as SQL expressions."""


def insert_if_absent(
    session: Session, table: type[Base], made: Changes = (), **values: Any
) -> bool:
    """Insert a row unless its key exists; return whether it was inserted.

    `made` are SQL expressions, `values` the rest of the row.
    """
    inserted: Any = session.execute(_insert_statement(_insert(session), table, made), values)
    return bool(inserted.rowcount == 1)


@lru_cache
def _insert_statement(insert: Any, table: type[Base], made: Changes) -> Executable:
    how: Executable = insert(table.__table__).values(dict(made)).on_conflict_do_nothing()
    return how


def upsert(
    session: Session,
    table: type[Base],
    made: Changes,
    changes: Changes,
    *,
    takes: tuple[str, ...],
    keys: tuple[str, ...],
) -> Executable:
    """Return a statement that inserts a row or, if its keys exist, updates the existing one.

    The statement is built once, and executed with the values of the new row. `made` are SQL
    expressions for the new row, `changes` for an existing row, `takes` the columns that an existing
    row takes from the new one, `keys` the unique columns.
    """
    return _upsert_statement(_insert(session), table, made, changes, takes, keys)


@lru_cache
def _upsert_statement(
    insert: Any,
    table: type[Base],
    made: Changes,
    changes: Changes,
    takes: tuple[str, ...],
    keys: tuple[str, ...],
) -> Executable:
    new = insert(table.__table__).values(dict(made))
    taken = {name: new.excluded[name] for name in takes}
    how: Executable = new.on_conflict_do_update(index_elements=keys, set_=dict(changes) | taken)
    return how


def _insert(session: Session) -> Any:
    return sqlite_insert if session.get_bind().dialect.name == "sqlite" else postgres_insert


def find_row(
    session: Session,
    table: type[Row],
    kind: str,
    key: str | int,
    *,
    lock: bool | dict[str, bool] = False,
) -> Row:
    """Return the row of a key, reread if it is locked; `kind` names it in the error.

    `lock` may hold options for the lock (`with_for_update` of `Session.get`).

    Raises:
        NotFound: There is none.
    """
    row = session.get(table, key, with_for_update=lock, populate_existing=bool(lock))
    if row is None:
        raise NotFound(kind, str(key))
    return row


def hold_words(session: Session, words: str) -> None:
    """Take an advisory lock on a text until the transaction ends; SQLite has one writer anyway."""
    if session.get_bind().dialect.name == "postgresql":
        key = func.hashtextextended(words, 0)
        session.execute(select(func.pg_advisory_xact_lock(key)))


def flush_or_refuse(session: Session, words: str) -> None:
    """Flush changes; if a constraint of the database forbids them, refuse with these words.

    Raises:
        Conflict: A key is taken, a deleted row is still referred to, or a referred row is gone.
    """
    try:
        session.flush()
    except IntegrityError:
        raise Conflict(words) from None
