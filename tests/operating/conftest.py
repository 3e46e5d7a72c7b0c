"""Records that have lived: teams, a scored, a rejected and a waiting submission, a board."""

import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from tests.chaos.story import tell

from exceptiondrive_records.boards.tables import BoardRow
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.submissions.file_store import FileStore


@dataclass(frozen=True)
class Lived:
    """Records and uploads on SQLite."""

    url: str
    database: Database
    files: FileStore
    uploads: Path


@pytest.fixture
def lived(tmp_path: Path, migrated_sqlite: Path) -> Iterator[Lived]:
    """The story of the fault suite's checker."""
    folder = tmp_path / "lived"
    folder.mkdir()
    shutil.copy(migrated_sqlite, folder / "records.sqlite3")
    url = f"sqlite:///{folder / 'records.sqlite3'}"
    database = Database(url)
    story = tell(database, folder)
    yield Lived(url, database, story.files, folder / "uploads")
    database.dispose()


@pytest.fixture
def sqlite_path(tmp_path: Path) -> Path:
    """Where a database may be made."""
    return tmp_path / "fresh.sqlite3"


@pytest.fixture
def add_board() -> Callable[[Database], int]:
    """Append a board like the last one, by its own number; return the id that it got."""

    def add(database: Database) -> int:
        with database.write() as session:
            last = session.query(BoardRow).order_by(BoardRow.id.desc()).first()
            assert last is not None
            row = BoardRow(
                phase_id=last.phase_id,
                protocol_digest=last.protocol_digest,
                split_revision=last.split_revision,
                number=last.number + 1,
                digest=last.digest,
                body_digest=last.body_digest,
                body=last.body,
                published_at=last.published_at,
            )
            session.add(row)
            session.flush()
            return row.id

    return add
