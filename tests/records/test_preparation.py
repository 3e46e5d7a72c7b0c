"""From nothing to records that can be worked with."""

from importlib import resources

from sqlalchemy import func, select

from exceptiondrive_records.audit.log import audit_page
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.operations.setup import prepare
from exceptiondrive_records.protocols.tables import ProtocolRow


def test_preparing_adds_every_protocol_that_ships_and_twice_changes_nothing(
    empty_database_url: str,
) -> None:
    folder = resources.files("exceptiondrive_schemas") / "protocols"
    shipped = [file for file in folder.iterdir() if file.name.endswith(".toml")]
    for _ in range(2):
        prepare(empty_database_url)
    database = Database(empty_database_url)
    with database.read() as session:
        assert session.scalar(select(func.count()).select_from(ProtocolRow)) == len(shipped)
        actors = {line.actor for line in audit_page(session)}
        assert actors == {"installation"}, "nobody did it"
    database.dispose()
