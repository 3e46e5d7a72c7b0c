"""Alembic migrations, applied by `migrate`."""

from functools import cache
from pathlib import Path

from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import inspect, text
from sqlalchemy.orm import Session

from exceptiondrive_records.db.base import Base
from exceptiondrive_records.db.database import Database

FOLDER = Path(__file__).parent
_LOCK = 0x45447363  # any constant: one migration at a time on PostgreSQL


def migrate(url: str) -> None:
    """Bring the database to the newest schema; all of a migration is applied, or nothing.

    A schema newer than this code knows is left as it is: migrations only add, so that this code
    runs on it, as it must between an upgrade and its taking back.
    """
    database = Database(url)
    try:
        with database.write() as session:
            if session.get_bind().dialect.name == "postgresql":
                session.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": _LOCK})
            config = alembic_config()
            if _is_newer(_revision_of(session)):
                return
            config.attributes["connection"] = session.connection()
            command.upgrade(config, "head")
    finally:
        database.dispose()


def alembic_config() -> Config:
    """Return the configuration that finds the migrations inside the package."""
    config = Config()
    config.set_main_option("script_location", str(FOLDER).replace("%", "%%"))
    config.set_main_option("path_separator", "os")
    return config


def newest_revision() -> str:
    """Return the revision that `migrate` leads to."""
    head = _scripts(FOLDER).get_current_head()
    assert head is not None
    return head


def is_current(database: Database) -> bool:
    """Whether the database has the newest schema that this code knows."""
    with database.read() as session:
        return _revision_of(session) == newest_revision()


def is_usable(database: Database) -> bool:
    """Whether this code can work with the schema: it is the newest known one, or newer still."""
    with database.read() as session:
        revision = _revision_of(session)
    return revision == newest_revision() or _is_newer(revision)


def missing_columns(database: Database) -> list[str]:
    """Return the tables and columns that this code needs and the database lacks, as `table.column`."""
    found = inspect(database.engine)
    known = {
        name: {it["name"] for it in found.get_columns(name)} for name in found.get_table_names()
    }
    return sorted(
        f"{table.name}.{column.name}" if table.name in known else table.name
        for table in Base.metadata.tables.values()
        for column in table.columns
        if column.name not in known.get(table.name, ())
    )


def _revision_of(session: Session) -> str | None:
    return MigrationContext.configure(session.connection()).get_current_revision()


def _is_newer(revision: str | None) -> bool:
    known = {script.revision for script in _scripts(FOLDER).walk_revisions()}
    return revision is not None and revision not in known


@cache
def _scripts(folder: Path) -> ScriptDirectory:
    return ScriptDirectory(str(folder))
