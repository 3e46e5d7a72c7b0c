"""The story on real databases."""

import dataclasses
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from sqlalchemy import text
from tests.chaos.story import Story, tell

from exceptiondrive_records.db.database import Database
from exceptiondrive_records.submissions.file_store import FileStore


@pytest.fixture
def story(database: Database, tmp_path: Path) -> Story:
    """The story on SQLite, then on PostgreSQL."""
    return tell(database, tmp_path)


@pytest.fixture(scope="session")
def told_once(migrated_sqlite: Path, tmp_path_factory: pytest.TempPathFactory) -> Story:
    """The story on SQLite, to copy from; without the triggers that forbid what is planted."""
    folder = tmp_path_factory.mktemp("story")
    shutil.copy(migrated_sqlite, folder / "records.sqlite3")
    database = Database(f"sqlite:///{folder / 'records.sqlite3'}")
    story = tell(database, folder)
    with database.write() as session:
        names = session.scalars(text("SELECT name FROM sqlite_master WHERE type = 'trigger'"))
        for name in list(names):
            session.execute(text(f'DROP TRIGGER "{name}"'))
    database.dispose()
    return story


@pytest.fixture
def embedded_story(told_once: Story, tmp_path: Path) -> Iterator[Story]:
    """A copy of the story on SQLite that a test may spoil."""
    folder = tmp_path / "copy"
    shutil.copytree(told_once.folder, folder)
    database = Database(f"sqlite:///{folder / 'records.sqlite3'}")
    files = FileStore((folder / "uploads").as_uri())
    history = told_once.history.so_far()
    yield dataclasses.replace(
        told_once, database=database, files=files, folder=folder, history=history
    )
    database.dispose()
