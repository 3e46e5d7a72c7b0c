"""The workshop's database file: commits wait for the disk, and errors become sentences."""

import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import ClassVar

from exceptiondrive_build.errors import BuildError


class Database:
    """Tables in the file; several processes may use it at once."""

    tables: ClassVar[str]
    """The statements that create the tables, if they do not exist."""

    def __init__(self, path: Path) -> None:
        """Open or create the file and its tables.

        Raises:
            BuildError: The file cannot be opened, or is no database.
        """
        self._path = path
        with self._told():
            self._connection = sqlite3.connect(path, timeout=60, isolation_level=None)
            self._connection.execute("PRAGMA journal_mode = WAL")
            self._connection.execute("PRAGMA synchronous = FULL")
            self._connection.execute("PRAGMA foreign_keys = ON")
            self._connection.executescript(self.tables)

    def close(self) -> None:
        """Close the file."""
        self._connection.close()

    @contextmanager
    def _told(self) -> Iterator[None]:
        try:
            yield
        except sqlite3.Error as error:
            advice = "Everything that was appended before is kept; see to the file or the disk."
            raise BuildError(f"{self._path}: {error}.", advice) from None

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        with self._told():
            self._connection.execute("BEGIN IMMEDIATE")
            try:
                yield self._connection
            except BaseException:
                if self._connection.in_transaction:
                    self._connection.execute("ROLLBACK")
                raise
            self._connection.execute("COMMIT")
