"""A pytest plugin: what stands before many tests is made once per process, then copied.

A copy holds the rows, the counters and the files that the making left, and it is the test's own.
"""

import copy
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Protocol, TypeVar

import psycopg
import pytest
from sqlalchemy import make_url
from tests.support.databases import TABLES

T = TypeVar("T")
_COUNTERS = (
    "SELECT format('%I.%I', schemaname, sequencename), last_value FROM pg_sequences"
    " WHERE last_value IS NOT NULL"
)


class Rows(Protocol):
    """The rows of a database, to be put into an empty one of the same schema."""

    def put(self, url: str) -> None: ...


@dataclass(frozen=True)
class SqliteRows:
    file: Path

    @classmethod
    def of(cls, url: str, file: Path) -> "SqliteRows":
        _copy_sqlite(_sqlite_file(url), file)
        return cls(file)

    def put(self, url: str) -> None:
        _copy_sqlite(self.file, _sqlite_file(url))


@dataclass(frozen=True)
class PostgresRows:
    tables: dict[str, bytes]
    counters: list[tuple[str, int]]

    @classmethod
    def of(cls, url: str) -> "PostgresRows":
        tables = {}
        with psycopg.connect(_postgres_address(url)) as connection:
            for (table,) in connection.execute(TABLES).fetchall():
                has_rows = connection.execute(f'SELECT 1 FROM "{table}" LIMIT 1').fetchone()
                if has_rows:
                    with connection.cursor().copy(
                        f'COPY "{table}" TO STDOUT (FORMAT BINARY)'
                    ) as out:
                        tables[table] = b"".join(out)
            counters = connection.execute(_COUNTERS).fetchall()
        return cls(tables, counters)

    def put(self, url: str) -> None:
        with psycopg.connect(_postgres_address(url)) as connection:
            connection.execute("SET LOCAL session_replication_role = replica")  # in any order
            for table, rows in self.tables.items():
                with connection.cursor().copy(f'COPY "{table}" FROM STDIN (FORMAT BINARY)') as into:
                    into.write(rows)
            for counter, value in self.counters:
                connection.execute("SELECT setval(%s::regclass, %s)", (counter, value))


class Snapshots:
    """What was made in this process, by name, kind of database and day: quotas are of a day."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._made: dict[tuple[Any, ...], tuple[Rows, Path, Any]] = {}

    def fill(self, name: str, url: str, folder: Path, make: Callable[[], T]) -> T:
        """Fill an empty database and a folder as `make` does; return what `make` returns.

        Args:
            name: Says what is made: the same name, the same rows and files.
            url: Of the database.
            folder: Its folders go with the rows.
            make: Fills both; what it writes is committed when it returns.
        """
        key = (name, make_url(url).get_backend_name(), datetime.now(UTC).date())
        if key not in self._made:
            value = make()
            kept = self._folder / str(len(self._made))
            kept.mkdir()
            for part in folder.iterdir():
                if part.is_dir():
                    shutil.copytree(part, kept / part.name)
            self._made[key] = (_rows_of(url, kept.with_suffix(".db")), kept, copy.deepcopy(value))
            return value
        rows, kept, value = self._made[key]
        rows.put(url)
        shutil.copytree(kept, folder, dirs_exist_ok=True)
        return copy.deepcopy(value)


@pytest.fixture(scope="session")
def snapshots(tmp_path_factory: pytest.TempPathFactory) -> Snapshots:
    """What this process has made."""
    return Snapshots(tmp_path_factory.mktemp("snapshots"))


def _rows_of(url: str, file: Path) -> Rows:
    is_sqlite = make_url(url).get_backend_name() == "sqlite"
    return SqliteRows.of(url, file) if is_sqlite else PostgresRows.of(url)


def _sqlite_file(url: str) -> Path:
    return Path(str(make_url(url).database))


def _copy_sqlite(source: Path, target: Path) -> None:
    with closing(sqlite3.connect(source)) as read, closing(sqlite3.connect(target)) as write:
        write.execute("PRAGMA synchronous = OFF")
        read.backup(write)


def _postgres_address(url: str) -> str:
    return url.replace("postgresql+psycopg://", "postgresql://")
