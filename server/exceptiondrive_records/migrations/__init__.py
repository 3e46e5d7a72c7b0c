"""Alembic migrations, applied by `migrate`."""

from pathlib import Path

from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import text

from exceptiondrive_records.database import Database

_LOCK = 0x45447363  # any constant: one migration at a time on PostgreSQL


def migrate(url: str) -> None:
    """Bring the database to the newest schema; all of a migration is applied, or nothing."""
    database = Database(url)
    try:
        with database.write() as session:
            if session.get_bind().dialect.name == "postgresql":
                session.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": _LOCK})
            config = alembic_config()
            config.attributes["connection"] = session.connection()
            command.upgrade(config, "head")
    finally:
        database.dispose()


def alembic_config() -> Config:
    """Return the configuration that finds the migrations inside the package."""
    config = Config()
    config.set_main_option("script_location", str(Path(__file__).parent).replace("%", "%%"))
    config.set_main_option("path_separator", "os")
    return config


def newest_revision() -> str:
    """Return the revision that `migrate` leads to."""
    head = ScriptDirectory.from_config(alembic_config()).get_current_head()
    assert head is not None
    return head


def is_current(database: Database) -> bool:
    """Whether the database has the newest schema."""
    with database.read() as session:
        context = MigrationContext.configure(session.connection())
        return context.get_current_revision() == newest_revision()
