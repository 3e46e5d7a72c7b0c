"""Migrations lead to the tables of the code, from nothing, twice, and at the same time."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from alembic import command
from alembic.autogenerate import compare_metadata
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import inspect, text
from tests.later_release import become_later_release

from exceptiondrive_records.db.base import Base
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.db.settings import SettingsError
from exceptiondrive_records.migrations import (
    FOLDER,
    MADE_EARLIER_CURE,
    is_current,
    is_usable,
    migrate,
    newest_revision,
)
from exceptiondrive_records.teams.teams import create_team, find_team


def test_migrating_an_empty_database_gives_exactly_the_tables_of_the_code(
    empty_database_url: str,
) -> None:
    migrate(empty_database_url)
    database = Database(empty_database_url)
    with database.engine.connect() as connection:
        context = MigrationContext.configure(connection, opts={"compare_type": True})
        assert compare_metadata(context, Base.metadata) == []
    assert is_current(database)
    database.dispose()


def test_the_file_of_a_migration_begins_with_its_revision() -> None:
    """So that nobody has to import all of them to know which is the newest."""
    scripts = ScriptDirectory(str(FOLDER))
    assert newest_revision() == scripts.get_current_head()
    for script in scripts.walk_revisions():
        assert Path(script.path).name.startswith(f"{script.revision}_")


def test_records_of_the_same_revision_that_lack_columns_are_no_records_that_are_up_to_date(
    database_url: str,
) -> None:
    """Before the first release the one migration changes in place."""
    database = Database(database_url)
    with database.write() as session:
        session.execute(text("ALTER TABLE submissions DROP COLUMN confirm_until"))
        session.execute(text("DROP TABLE split_openings"))
    database.dispose()
    with pytest.raises(SettingsError) as refused:
        migrate(database_url)
    said = str(refused.value)
    assert said.startswith("the records lack split_openings, submissions.confirm_until: ")
    assert MADE_EARLIER_CURE in said


def test_migrating_twice_does_nothing(database_url: str) -> None:
    migrate(database_url)
    migrate(database_url)


def test_parallel_migrations_wait_for_each_other(empty_database_url: str) -> None:
    with ThreadPoolExecutor(3) as pool:
        list(pool.map(migrate, [empty_database_url] * 3))
    database = Database(empty_database_url)
    assert is_current(database)
    database.dispose()


def test_a_migration_that_breaks_off_leaves_nothing(
    empty_database_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    upgrade = command.upgrade

    def upgrade_and_break_off(config: Config, revision: str) -> None:
        upgrade(config, revision)
        raise KeyboardInterrupt

    monkeypatch.setattr(command, "upgrade", upgrade_and_break_off)
    with pytest.raises(KeyboardInterrupt):
        migrate(empty_database_url)
    monkeypatch.undo()
    database = Database(empty_database_url)
    assert inspect(database.engine).get_table_names() == []
    assert not is_current(database)
    migrate(empty_database_url)
    assert is_current(database)
    database.dispose()


def test_sqlite_in_memory_is_refused_since_processes_share_the_records() -> None:
    with pytest.raises(ValueError, match="needs a file"):
        Database("sqlite://")


def test_sqlite_keeps_commits_and_waits_for_other_writers(sqlite_url: str, tmp_path: Path) -> None:
    database = Database(sqlite_url)
    with database.read() as session:
        pragmas = {
            name: session.connection().exec_driver_sql(f"PRAGMA {name}").scalar()
            for name in (
                "journal_mode",
                "synchronous",
                "foreign_keys",
                "busy_timeout",
                "secure_delete",
            )
        }
    assert pragmas == {
        "journal_mode": "wal",
        "synchronous": 2,
        "secure_delete": 1,
        "foreign_keys": 1,
        "busy_timeout": 15_000,
    }
    database.dispose()


def test_an_older_schema_is_refused_and_migrated_with_what_is_in_it(
    database_url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    database = Database(database_url)
    with database.write() as session:
        create_team(session, "alpha", "Alpha", actor="test")
    become_later_release(monkeypatch, tmp_path)
    assert (is_usable(database), is_current(database)) == (False, False)
    migrate(database_url)
    assert (is_usable(database), is_current(database)) == (True, True)
    assert "made_later" in inspect(database.engine).get_table_names()
    with database.read() as session:
        assert find_team(session, "alpha").name == "Alpha"
    database.dispose()


def test_a_newer_schema_is_left_alone_and_worked_with(
    database_url: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After an upgrade is taken back, the older code meets what it does not know."""
    database = Database(database_url)
    with monkeypatch.context() as upgraded:
        become_later_release(upgraded, tmp_path)
        migrate(database_url)
    migrate(database_url)
    assert "made_later" in inspect(database.engine).get_table_names()
    assert is_usable(database)
    assert not is_current(database)
    database.dispose()
