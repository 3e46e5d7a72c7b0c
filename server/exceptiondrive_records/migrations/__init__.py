"""Alembic migrations, applied by `migrate`; other commands check the schema without Alembic."""

from functools import cache
from pathlib import Path

from sqlalchemy import inspect, text
from sqlalchemy.orm import Session

from exceptiondrive_records.db.base import Base
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.db.settings import SettingsError

MADE_EARLIER_CURE = "take a new database, or go on with the version that made these records"
FOLDER = Path(__file__).parent
_LOCK = 0x45447363  # any constant: one migration at a time on PostgreSQL


def migrate(url: str) -> None:
    """Upgrade the database to the newest schema; each migration is atomic.

    A schema newer than this code is left unchanged: migrations only add, so that this code works
    with it after the rollback of an upgrade.

    Raises:
        SettingsError: The records have an unreleased state of this schema, which lacks columns.
    """
    database = Database(url)
    try:
        _upgrade(database)
        if lacks := missing_schema(database):
            raise SettingsError(f"{lacks}. Nothing can be migrated: {MADE_EARLIER_CURE}.")
    finally:
        database.dispose()


def _upgrade(database: Database) -> None:
    with database.write() as session:
        if session.get_bind().dialect.name == "postgresql":
            session.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": _LOCK})
        if _is_usable(session):
            return
        from alembic import command
        from alembic.config import Config

        config = Config(attributes={"connection": session.connection()})
        config.set_main_option("script_location", str(FOLDER).replace("%", "%%"))
        config.set_main_option("path_separator", "os")
        command.upgrade(config, "head")


def newest_revision() -> str:
    """Return the revision to which `migrate` upgrades."""
    return _revisions(FOLDER)[-1]


def is_current(database: Database) -> bool:
    """Whether the database has the newest schema that this code knows."""
    with database.read() as session:
        return _revision_of(session) == newest_revision()


def is_usable(database: Database) -> bool:
    """Whether this code can use the schema: it is the newest known one, or a newer one."""
    with database.read() as session:
        return _is_usable(session)


def missing_schema(database: Database) -> str:
    """Name the tables and columns that this code needs and the database lacks; empty if none."""
    found = inspect(database.engine)
    known = {
        name: {it["name"] for it in found.get_columns(name)} for name in found.get_table_names()
    }
    missing = {
        f"{table.name}.{column.name}" if table.name in known else table.name
        for table in Base.metadata.tables.values()
        for column in table.columns
        if column.name not in known.get(table.name, ())
    }
    if not missing:
        return ""
    return f"the records lack {', '.join(sorted(missing))}: they were made before this version had them"


def _is_usable(session: Session) -> bool:
    revision = _revision_of(session)
    is_older = revision is None or revision in _revisions(FOLDER)[:-1]
    return not is_older


def _revision_of(session: Session) -> str | None:
    if not inspect(session.connection()).has_table("alembic_version"):
        return None
    revision: str | None = session.scalar(text("SELECT version_num FROM alembic_version"))
    return revision


@cache
def _revisions(folder: Path) -> list[str]:
    """Return the revisions that this code knows, oldest first; file names begin with them."""
    return sorted(file.name.partition("_")[0] for file in folder.glob("versions/[0-9]*_*.py"))
