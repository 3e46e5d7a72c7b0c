"""A PostgreSQL of the tests: each test has a database of its own, emptied and renamed for the next.

Making and dropping a database costs the server a fifth of a second of processor time, emptying one
a hundredth. One whose schema a test has changed is dropped.
"""

import uuid
from dataclasses import dataclass, field

import psycopg

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
_TABLES = (
    "SELECT tablename FROM pg_tables WHERE schemaname = 'public' AND tablename <> 'alembic_version'"
)
_RESTART = "SELECT setval(format('%I.%I', schemaname, sequencename)::regclass, start_value, false) FROM pg_sequences"


@dataclass
class Postgres:
    """A running server."""

    uri: str
    _pristine: str = ""
    _empty: list[str] = field(default_factory=list)
    _copies: set[str] = field(default_factory=set)

    def create(self, template: str) -> str:
        """Return the name of a database like its template, of the caller alone."""
        if template == TEMPLATE and self._empty:
            return self._empty.pop()
        name = _new_name()
        with psycopg.connect(self.uri, autocommit=True) as connection:
            connection.execute(f'CREATE DATABASE "{name}" TEMPLATE "{template}"')
        if template == TEMPLATE:
            self._copies.add(name)
        return name

    def drop(self, name: str) -> None:
        """Take a database back; who still knows its name finds nothing."""
        if name in self._copies:
            self._copies.remove(name)
            new = _new_name()
            if self._renamed(name, new):
                name = new
                if self._emptied(name):
                    self._copies.add(name)
                    self._empty.append(name)
                    return
        with psycopg.connect(self.uri, autocommit=True) as connection:
            connection.execute(f'DROP DATABASE IF EXISTS "{name}" WITH (FORCE)')

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

    def _renamed(self, name: str, new: str) -> bool:
        with psycopg.connect(self.uri, autocommit=True) as connection:
            try:
                connection.execute(
                    "SELECT pg_terminate_backend(pid, 5000) FROM pg_stat_activity WHERE datname = %s",
                    (name,),
                )
                connection.execute(f'ALTER DATABASE "{name}" RENAME TO "{new}"')
            except psycopg.Error:  # dropped by its test, or somebody came in meanwhile
                return False
        return True

    def _emptied(self, name: str) -> bool:
        with psycopg.connect(self.address(name)) as connection:
            if _shape(connection) != self._pristine:
                return False
            connection.execute("SET LOCAL session_replication_role = replica")  # append-only tables
            tables = [table for (table,) in connection.execute(_TABLES).fetchall()]
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
