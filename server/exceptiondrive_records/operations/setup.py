"""Create or migrate the records, and refuse to open any whose schema does not fit."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sqlalchemy import make_url
from sqlalchemy.exc import DBAPIError

from exceptiondrive_records.db.database import Database, sentence_of
from exceptiondrive_records.db.settings import RecordsSettings, SettingsError
from exceptiondrive_records.migrations import is_usable, migrate
from exceptiondrive_records.protocols.protocols import add_protocol
from exceptiondrive_schemas.protocol import PACKAGED_PROTOCOLS

_ACTOR = "installation"
DATA_HELP = (
    "Folder of `exceptiondrive-server run`; needed unless it is ./data or "
    "EXCEPTIONDRIVE_DATABASE_URL is set."
)
"""Help text of the option `--data` of every command."""


def prepare(database_url: str) -> None:
    """Bring the schema up to date and add the packaged protocols. Idempotent.

    Raises:
        Conflict: A packaged version was recorded with other content.
    """
    migrate(database_url)
    database = Database(database_url)
    try:
        with database.write() as session:
            for file in sorted(PACKAGED_PROTOCOLS.glob("*.toml")):
                add_protocol(session, file.read_text(encoding="utf-8"), _ACTOR)
    finally:
        database.dispose()


@contextmanager
def opened(settings: RecordsSettings) -> Iterator[Database]:
    """Open records that exist and have the newest schema; never create them.

    Raises:
        SettingsError: They do not; the text says where they were expected, and what to do.
    """
    url = make_url(settings.database_url)
    if url.get_backend_name() == "sqlite" and not _holds_anything(Path(url.database or "")):
        raise SettingsError(
            f"there are no records at {Path(url.database or '').absolute()}. Name the folder of "
            "the running server with --data, set EXCEPTIONDRIVE_DATABASE_URL, or make them: "
            "exceptiondrive-server migrate"
        )
    database = Database(settings.database_url)
    try:
        if not is_usable(database):
            raise SettingsError("the records are not up to date: run exceptiondrive-server migrate")
        yield database
    except DBAPIError as error:
        raise SettingsError(sentence_of(error)) from None
    finally:
        database.dispose()


def _holds_anything(path: Path) -> bool:
    """Whether a database of SQLite was ever written: one that was only opened is an empty file."""
    return path.is_file() and path.stat().st_size > 0
