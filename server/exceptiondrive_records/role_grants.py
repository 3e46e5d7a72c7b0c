"""Roles made and given their rights, by the owner of the database."""

from pathlib import Path

from psycopg import Connection, sql
from sqlalchemy import URL, make_url, text
from sqlalchemy.orm import Session

from exceptiondrive_records.database import Database
from exceptiondrive_records.errors import InvalidRecord
from exceptiondrive_records.roles import Role, grants


def role_of(address: str) -> tuple[Role, URL]:
    """Return the role that an address connects as, and the address.

    Raises:
        InvalidRecord: It is no address of PostgreSQL, or connects as somebody else.
    """
    url = make_url(address)
    found = next((role for role in Role if role == url.username), None)
    if found is None or url.get_backend_name() != "postgresql":
        known = ", ".join(Role)
        raise InvalidRecord(f"The address must connect to PostgreSQL as one of: {known}.")
    return found, url


def grant_to_files(owner_url: str, files: list[Path]) -> list[Role]:
    """Give the roles of addresses in files their rights; roles that are not there are made.

    A new role gets the password of its address; that of an existing one is left alone.

    Args:
        owner_url: Address with which the owner of the tables connects.
        files: Each holds the address with which one service connects.

    Raises:
        InvalidRecord: The database is no PostgreSQL, or an address is no role's.
    """
    if make_url(owner_url).get_backend_name() != "postgresql":
        raise InvalidRecord("Roles are for PostgreSQL; SQLite knows none.")
    addresses = [role_of(file.read_text(encoding="utf-8").strip()) for file in files]
    database = Database(owner_url)
    try:
        with database.write() as session:
            for role, url in addresses:
                make_role(session, role, None if url.password is None else str(url.password))
                grant(session, role)
    finally:
        database.dispose()
    return [role for role, _ in addresses]


def make_role(session: Session, role: Role, password: str | None = None) -> None:
    """Make a role that may sign in, unless it is there; the log sees a digest of the password."""
    query = text("SELECT 1 FROM pg_roles WHERE rolname = :name")
    if session.scalar(query, {"name": str(role)}) is not None:
        return
    session.execute(text(f"CREATE ROLE {role} LOGIN"))
    if password is not None:
        driver = session.connection().connection.driver_connection
        assert isinstance(driver, Connection)
        secret = driver.pgconn.encrypt_password(password.encode(), role.encode(), b"scram-sha-256")
        change = sql.SQL("ALTER ROLE {} PASSWORD {}").format(
            sql.Identifier(role), sql.Literal(secret.decode())
        )
        driver.execute(change)


def grant(session: Session, role: Role) -> None:
    """Give a role exactly its rights."""
    for statement in grants(role):
        session.execute(text(statement))
