"""From nothing, or from an older version, to records that can be worked with."""

from importlib import resources

from exceptiondrive_records.db.database import Database
from exceptiondrive_records.migrations import migrate
from exceptiondrive_records.protocols.protocols import add_protocol

_ACTOR = "installation"


def prepare(database_url: str) -> None:
    """Bring the schema up to date and add the protocols that ship; doing it again changes nothing.

    Raises:
        Conflict: A protocol was recorded under a shipped version with other content.
    """
    migrate(database_url)
    database = Database(database_url)
    folder = resources.files("exceptiondrive_schemas") / "protocols"
    try:
        documents = [file for file in folder.iterdir() if file.name.endswith(".toml")]
        with database.write() as session:
            for file in sorted(documents, key=lambda entry: entry.name):
                add_protocol(session, file.read_text(encoding="utf-8"), _ACTOR)
    finally:
        database.dispose()
