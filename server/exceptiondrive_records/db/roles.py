"""Database roles in production: least privilege for each service on each table.

`RIGHTS` is the only source: `exceptiondrive-server roles` prints its statements, `migrate
--grant-to` applies them, and tests run the services under these roles. The owner of the tables runs
migrations; no service connects as the owner.
"""

from collections.abc import Iterator, Mapping
from enum import StrEnum
from pathlib import Path

from sqlalchemy import URL, make_url, text
from sqlalchemy.exc import OperationalError
from sqlalchemy.orm import Session

from exceptiondrive_records.db.base import Base
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.db.errors import InvalidRecord


class Role(StrEnum):
    """The services that connect to the database, besides its owner."""

    API = "exceptiondrive_api"
    WORKER = "exceptiondrive_worker"
    RECONCILER = "exceptiondrive_reconciler"


R, RI, RU, RIU, RID, RIUD = (
    "SELECT",
    "SELECT, INSERT",
    "SELECT, UPDATE",
    "SELECT, INSERT, UPDATE",
    "SELECT, INSERT, DELETE",
    "SELECT, INSERT, UPDATE, DELETE",
)
NONE = ""
_STATUS = "SELECT, UPDATE (status, status_at, report, confirm_until, failure_code, failure_message)"
_POINTER = "SELECT, UPDATE (current_board_id, late_board_id)"
_CONFIRMATIONS = "SELECT, INSERT, UPDATE (withdrawn_at)"
_VERSIONS = "alembic_version"


def _all_but(table: str, *fixed: str) -> str:
    """Return the rights to select and insert, and to update all columns except the fixed ones."""
    columns = [column.name for column in Base.metadata.tables[table].columns]
    return f"SELECT, INSERT, UPDATE ({', '.join(name for name in columns if name not in fixed)})"


_PHASES = "DELETE, " + _all_but("phases", "id", "challenge", "split_name", "created_at")
_SUBMISSIONS = _all_but(
    "submissions",
    "id",
    "phase_id",
    "file_digest",
    "size_bytes",
    "received_at",
    "arrived_at",
)
RIGHTS: Mapping[str, tuple[str, str, str]] = {
    # table: (api, worker, reconciler)
    _VERSIONS: (R, R, R),
    "allowances": (RIUD, R, R),
    "audit_lines": (RI, RI, RI),  # append-only for everyone
    "board_entries": (R, RI, R),
    "board_flips": (RI, RI, R),
    "boards": (R, RI, R),  # only workers publish
    "confirmations": (_CONFIRMATIONS, R, R),  # workers trust the signature, not the row
    "contact_points": (RIUD, R, R),
    "disqualifications": (RIU, R, R),
    "entry_drawings": (R, RI, R),
    "invitations": (RIUD, NONE, NONE),
    "memberships": (RID, NONE, NONE),
    "news": (RIU, NONE, NONE),
    "notifications": (RIUD, RI, RI),
    "people": (RIU, NONE, NONE),
    "phases": (_PHASES, _POINTER, R),
    "protocol_drawings": (R, RI, R),
    "protocols": (RID, R, R),  # foreign keys protect those in use
    "questions": (RIUD, NONE, NONE),
    "receipt_keys": (RI, NONE, NONE),
    "reported_boards": (RIU, NONE, NONE),
    "rescoring_runs": (RIU, R, RU),
    "sample_pictures": (R, RID, R),
    "score_sheets": (R, RI, R),  # only workers score
    "sessions": (RIUD, NONE, NONE),
    "sign_in_attempts": (RIUD, NONE, NONE),
    "similarities": (R, RI, R),
    "site_settings": (RIU, NONE, NONE),
    "split_openings": (R, RI, R),  # an opening counts forever
    "splits": (R, RIU, R),
    "submission_edits": (RI, NONE, NONE),
    "submissions": (_SUBMISSIONS, _STATUS, _STATUS),
    "terms_acceptances": (RID, NONE, R),
    "teams": (RIUD, R, R),
    "tokens": (RIUD, NONE, NONE),
    "work": (RIUD, RIU, RIUD),  # by kind: `WORK_RIGHTS`
    "worker_heartbeats": (R, RIUD, R),
}
"""Every table must be listed: a test compares this with the tables of the code."""


WORK_RIGHTS: Mapping[str, tuple[str, str, str]] = {
    # kind of work: (api, worker, reconciler)
    "board": (RIU, RIU, RIU),
    "delivery": (RIUD, RI, RIU),
    "lead": (R, NONE, RIUD),
    "profile": (RI, RU, RU),
    "recheck": (RIU, RU, RU),
    "trial": (RI, RU, RU),
    "score": (RIUD, RU, RIUD),  # workers score, and request no scoring
}
"""All work is in one table; row-level policies restrict each role to its kinds."""


def rights_of(role: Role) -> dict[str, str]:
    """Return the rights of a role by table, as the text between GRANT and ON."""
    column = list(Role).index(role)
    return {table: rights[column] for table, rights in RIGHTS.items() if rights[column]}


def grants(role: Role) -> Iterator[str]:
    """Yield the statements that grant a role its rights and revoke all others."""
    yield f"REVOKE ALL ON ALL TABLES IN SCHEMA public FROM {role}"
    yield f"REVOKE ALL ON ALL SEQUENCES IN SCHEMA public FROM {role}"
    yield "REVOKE CREATE ON SCHEMA public FROM PUBLIC"
    yield _NO_TEMPORARY_TABLES
    yield _NO_LARGE_OBJECTS
    yield f"GRANT USAGE ON SCHEMA public TO {role}"
    for table, rights in rights_of(role).items():
        yield f"GRANT {rights} ON {table} TO {role}"
        if "INSERT" in rights and table in _NUMBERED:
            yield f"GRANT USAGE ON SEQUENCE {table}_id_seq TO {role}"
    yield from _work_policies(role)
    yield from _PHASES_FOLLOW_BOARDS
    yield from _READERS_GET_THE_NEWEST


_NO_TEMPORARY_TABLES = """DO $$ BEGIN
    EXECUTE format('REVOKE TEMPORARY ON DATABASE %I FROM PUBLIC', current_database());
END $$"""


_NO_LARGE_OBJECTS = """DO $$ DECLARE maker regprocedure; BEGIN
    IF current_setting('is_superuser') = 'on' THEN
        FOR maker IN SELECT oid FROM pg_proc WHERE pronamespace = 'pg_catalog'::regnamespace
            AND proname IN ('lo_creat', 'lo_create', 'lo_from_bytea', 'lo_import')
        LOOP EXECUTE format('REVOKE EXECUTE ON FUNCTION %s FROM PUBLIC', maker); END LOOP;
    END IF;
END $$"""
"""Large objects could fill the disk despite the table rights. Only a superuser can revoke them."""


_PHASES_FOLLOW_BOARDS = (
    f"""CREATE OR REPLACE FUNCTION phases_follow_boards() RETURNS trigger LANGUAGE plpgsql
    SET search_path = public AS $$ BEGIN
        IF current_user <> '{Role.API}' OR EXISTS (
            SELECT FROM boards WHERE phase_id = NEW.id
            AND protocol_digest = NEW.protocol_digest AND split_revision = NEW.split_revision
        ) OR NOT EXISTS (SELECT FROM boards WHERE phase_id = NEW.id) AND EXISTS (
            SELECT FROM splits WHERE name = NEW.split_name AND revision = NEW.split_revision
            AND part IS DISTINCT FROM 'private'
        ) THEN RETURN NEW; END IF;
        RAISE insufficient_privilege USING MESSAGE = 'no worker has built such a board';
    END $$""",
    "DROP TRIGGER IF EXISTS phases_follow_boards ON phases",
    """CREATE TRIGGER phases_follow_boards
    BEFORE INSERT OR UPDATE OF protocol_digest, split_revision ON phases
    FOR EACH ROW EXECUTE FUNCTION phases_follow_boards()""",
)
"""The server may point a phase only at a protocol and split revision for which a worker, respecting
the floors, built a board; a phase without boards at any revision except one of a private part."""


_READERS_GET_THE_NEWEST = (
    f"""CREATE OR REPLACE FUNCTION pointer_goes_to_newest() RETURNS trigger LANGUAGE plpgsql
    SET search_path = public AS $$ BEGIN
        IF current_user <> '{Role.API}' OR (
            NEW.late_board_id IS NULL OR NEW.late_board_id = OLD.late_board_id
        ) AND (
            NEW.current_board_id IS NULL OR NEW.current_board_id = OLD.current_board_id
            OR NEW.current_board_id = (
                SELECT id FROM boards WHERE phase_id = NEW.id AND view = 'main'
                AND protocol_digest = NEW.protocol_digest AND split_revision = NEW.split_revision
                ORDER BY number DESC LIMIT 1
            )
        ) THEN RETURN NEW; END IF;
        RAISE insufficient_privilege USING MESSAGE = 'the server shows the newest board alone';
    END $$""",
    "DROP TRIGGER IF EXISTS pointer_goes_to_newest ON phases",
    """CREATE TRIGGER pointer_goes_to_newest
    BEFORE INSERT OR UPDATE OF current_board_id, late_board_id ON phases
    FOR EACH ROW EXECUTE FUNCTION pointer_goes_to_newest()""",
    f"""CREATE OR REPLACE FUNCTION flips_follow_pointer() RETURNS trigger LANGUAGE plpgsql
    SET search_path = public AS $$ BEGIN
        IF current_user <> '{Role.API}' OR NEW.at <= clock_timestamp()
        AND NEW.at > clock_timestamp() - interval '1 minute'
        AND NEW.board_id = (SELECT current_board_id FROM phases WHERE id = NEW.phase_id)
        AND NEW.board_id IS DISTINCT FROM (
            SELECT board_id FROM board_flips WHERE phase_id = NEW.phase_id ORDER BY id DESC LIMIT 1
        ) THEN RETURN NEW; END IF;
        RAISE insufficient_privilege USING MESSAGE = 'the phase shows no such board since now';
    END $$""",
    "DROP TRIGGER IF EXISTS flips_follow_pointer ON board_flips",
    """CREATE TRIGGER flips_follow_pointer BEFORE INSERT ON board_flips
    FOR EACH ROW EXECUTE FUNCTION flips_follow_pointer()""",
)
"""The server may show only the newest board of the present protocol and split, and record a flip
only with the present time. Only workers set the board of the late view; the server may clear it."""


def _work_policies(role: Role) -> Iterator[str]:
    """Yield row policies of the work table: all may read; a change needs the right to the kind."""
    yield "ALTER TABLE work ENABLE ROW LEVEL SECURITY"
    column = list(Role).index(role)
    for verb in ("SELECT", "INSERT", "UPDATE", "DELETE"):
        kinds = [f"'{kind}'" for kind, rights in WORK_RIGHTS.items() if verb in rights[column]]
        rows = "true" if verb == "SELECT" else f"kind IN ({', '.join(kinds)})" if kinds else "false"
        clause = f"WITH CHECK ({rows})" if verb == "INSERT" else f"USING ({rows})"
        name = f"{role}_{verb.lower()}"
        yield f"DROP POLICY IF EXISTS {name} ON work"
        yield f"CREATE POLICY {name} ON work FOR {verb} TO {role} {clause}"


_NUMBERED = frozenset(
    table.name for table in Base.metadata.tables.values() if table.autoincrement_column is not None
)
"""Tables whose ids come from a sequence of the database."""


# Creation of roles and their grants, by the owner of the database.


def role_of(address: str) -> tuple[Role, URL]:
    """Return the role that an address connects as, and the address.

    Raises:
        InvalidRecord: It is no PostgreSQL address, or its user is none of the roles.
    """
    url = make_url(address)
    found = next((role for role in Role if role == url.username), None)
    if found is None or url.get_backend_name() != "postgresql":
        known = ", ".join(Role)
        raise InvalidRecord(f"The address must connect to PostgreSQL as one of: {known}.")
    return found, url


def grant_to_files(owner_url: str, files: list[Path]) -> list[Role]:
    """Grant rights to the roles of addresses in files; create missing roles.

    Each file holds the address with which one service connects. A role that cannot sign in with its
    address gets the password in it: a new role, or one whose password was changed in the file.

    Raises:
        InvalidRecord: The database is no PostgreSQL, or an address is of no role.
    """
    if make_url(owner_url).get_backend_name() != "postgresql":
        raise InvalidRecord("Roles are for PostgreSQL; SQLite knows none.")
    addresses = [role_of(file.read_text(encoding="utf-8").strip()) for file in files]
    database = Database(owner_url)
    try:
        with database.write() as session:
            for role, url in addresses:
                is_new = make_role(session, role)
                if url.password is not None and (is_new or not _can_connect(url)):
                    _set_password(session, role, url.password)
                grant(session, role)
    finally:
        database.dispose()
    return [role for role, _ in addresses]


def make_role(session: Session, role: Role) -> bool:
    """Create a role that may log in, unless it exists; return whether it was created."""
    query = text("SELECT 1 FROM pg_roles WHERE rolname = :name")
    if session.scalar(query, {"name": str(role)}) is not None:
        return False
    session.execute(text(f"CREATE ROLE {role} LOGIN"))
    return True


def _can_connect(url: URL) -> bool:
    database = Database(url.render_as_string(hide_password=False))
    try:
        database.engine.connect().close()
    except OperationalError:
        return False
    finally:
        database.dispose()
    return True


def _set_password(session: Session, role: Role, password: str) -> None:
    """Set a role's password; the database's log shows only a digest of it."""
    from psycopg import Connection, sql  # needed for PostgreSQL only

    driver = session.connection().connection.driver_connection
    assert isinstance(driver, Connection)
    secret = driver.pgconn.encrypt_password(password.encode(), role.encode(), b"scram-sha-256")
    change = sql.SQL("ALTER ROLE {} LOGIN PASSWORD {}").format(
        sql.Identifier(role), sql.Literal(secret.decode())
    )
    driver.execute(change)


def grant(session: Session, role: Role) -> None:
    """Grant a role exactly its rights."""
    for statement in grants(role):
        session.execute(text(statement))
