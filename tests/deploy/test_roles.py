"""Least privilege: each service may do what its row says, and is refused what it must not do."""

import importlib
from collections.abc import Callable, Iterator
from contextlib import ExitStack, nullcontext
from pathlib import Path

import psycopg
import pytest
from psycopg import errors
from sqlalchemy import make_url
from tests.support.databases import Postgres, as_role
from tests.support.documents import make_manifest
from tests.support.records import add_phase

from exceptiondrive_records.db.base import Base
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.db.errors import InvalidRecord
from exceptiondrive_records.db.roles import RIGHTS, WORK_RIGHTS, Role, grant_to_files, rights_of
from exceptiondrive_records.protocols.protocols import add_protocol
from exceptiondrive_records.splits.splits import register_split
from exceptiondrive_records.work.tables import WorkItem
from exceptiondrive_schemas.api.phase_settings import SplitPart
from exceptiondrive_schemas.protocol import packaged_protocol_toml
from exceptiondrive_worker.sample.files import write_sample_split

pytestmark = pytest.mark.postgres
Ask = Callable[[Role, str], object]
PRIVILEGES = ("SELECT", "INSERT", "UPDATE", "DELETE", "TRUNCATE", "REFERENCES", "TRIGGER")


def test_every_table_has_a_row_that_says_who_may_do_what() -> None:
    assert set(RIGHTS) == {*Base.metadata.tables, "alembic_version"}, (
        "a new table needs its row in exceptiondrive_records/db/roles.py"
    )


@pytest.fixture
def records_url(postgres: Postgres) -> Iterator[str]:
    name = postgres.create("migrated")
    yield postgres.url(name)
    postgres.drop(name)


@pytest.fixture
def ask(records_url: str) -> Iterator[Ask]:
    """Executes a statement as a role."""
    with ExitStack() as stack:
        connections = {}
        for role in Role:
            url = as_role(records_url, role).replace("+psycopg", "")
            connections[role] = stack.enter_context(psycopg.connect(url, autocommit=True))

        def run(role: Role, statement: str) -> object:
            found = connections[role].execute(statement)
            return found.fetchone() if found.description else None

        yield run


def test_the_database_grants_exactly_the_table(ask: Ask) -> None:
    for role in Role:
        for table in RIGHTS:
            given = rights_of(role).get(table, "")
            for privilege in PRIVILEGES:
                is_whole = f"{privilege} (" not in given and privilege in given
                found = ask(role, f"SELECT has_table_privilege('{table}', '{privilege}')")
                assert found == (is_whole,), (role, table, privilege)


REFUSED = [
    *((role, f"{change} audit_lines{rest}") for role in Role for change, rest in (
        ("UPDATE", " SET actor = 'x'"), ("DELETE FROM", ""), ("TRUNCATE", ""),
        ("DROP TABLE", ""), ("ALTER TABLE", " DISABLE TRIGGER ALL"),
    )),
    *((role, f"SELECT * FROM {table}") for role in (Role.WORKER, Role.RECONCILER) for table in (
        "tokens", "sessions", "people", "invitations", "memberships",
        "sign_in_attempts", "site_settings",
    )),
    *((role, f"{change} {table}{rest}") for role in (Role.API, Role.RECONCILER)
      for table in ("score_sheets", "boards", "entry_drawings") for change, rest in (
        ("INSERT INTO", " DEFAULT VALUES"), ("UPDATE", " SET created_at = now()"
         if table != "boards" else " SET body = ''"), ("DELETE FROM", ""),
    )),
    *((role, statement) for role in Role for statement in (
        "CREATE TABLE mine (id int)", "CREATE ROLE another", "SET ROLE postgres",
        "ALTER ROLE exceptiondrive_worker SUPERUSER", "SELECT pg_read_file('/etc/passwd')",
        "UPDATE score_sheets SET exact_digest = 'x'", "UPDATE protocols SET toml = ''",
        "UPDATE board_flips SET board_id = 1", "DELETE FROM submissions",
        "UPDATE alembic_version SET version_num = 'x'",
    )),
    *((role, f"DELETE FROM {table}") for role in (Role.WORKER, Role.RECONCILER)
      for table in ("teams", "phases", "protocols", "rescoring_runs")),
    (Role.WORKER, "UPDATE phases SET quota_per_day = 1000"),
    *((role, "UPDATE submissions SET team_id = 1") for role in (Role.WORKER, Role.RECONCILER)),
    # the API merges teams; it may rename them, too, so it could always say whose an entry is
    (Role.WORKER, "INSERT INTO submissions DEFAULT VALUES"),
    (Role.WORKER, "UPDATE teams SET name = 'x'"),
    (Role.RECONCILER, "UPDATE submissions SET file_digest = 'x'"),
    *((role, statement) for role in Role for statement in (
        "UPDATE phases SET split_name = 'other'",
        "UPDATE phases SET created_at = now()", "UPDATE phases SET challenge = 'strategy'",
        "UPDATE submissions SET phase_id = 'x'",
        "UPDATE submissions SET received_at = now()", "UPDATE submissions SET file_digest = 'x'",
        "UPDATE score_sheets SET created_at = now()",
    )),
    (Role.API, "INSERT INTO splits DEFAULT VALUES"),
    (Role.API, "UPDATE splits SET public_file_digest = 'x'"),
    (Role.API, "DELETE FROM worker_heartbeats"),
    (Role.API, "DELETE FROM disqualifications"),
    (Role.API, "INSERT INTO board_entries DEFAULT VALUES"),
]  # fmt: skip


@pytest.fixture
def pointed(records_url: str) -> None:
    """A phase without a board, on the public part of a split with parts, and another protocol."""
    database = Database(records_url)
    with database.write() as session:
        for version in ("1.0", "1.1"):
            add_protocol(session, packaged_protocol_toml(version), "test")
        manifest = make_manifest()
        parts: dict[SplitPart, str] = {"public": "sha256:p", "private": "sha256:q"}
        counts = {"sudden_emergence": len(manifest.sample_ids)}
        register_split(session, manifest, counts, "test", parts=parts)
        for part, revision in parts.items():
            of_part = manifest.model_copy(update={"revision": revision})
            register_split(session, of_part, {"sudden_emergence": 1}, "test", part=part)
        add_phase(session)
    database.dispose()


POINT = "UPDATE phases SET split_revision = (SELECT revision FROM splits WHERE part = '{}')"
OTHER = "UPDATE phases SET protocol_digest = (SELECT digest FROM protocols WHERE version = '1.1')"


@pytest.mark.usefixtures("pointed")
def test_the_server_points_no_phase_at_what_no_worker_has_built_a_board_of(ask: Ask) -> None:
    """Under its role: before the first board not at the private part, later at built boards alone."""
    ask(Role.API, POINT.format("public"))
    with pytest.raises(errors.InsufficientPrivilege, match="no worker has built"):
        ask(Role.API, POINT.format("private"))
    ask(Role.WORKER, NEW_BOARD.format(1))
    for statement in (POINT.format("private"), OTHER):
        with pytest.raises(errors.InsufficientPrivilege, match="no worker has built"):
            ask(Role.API, statement)
    ask(Role.API, "UPDATE phases SET title = 'still changed'")
    with pytest.raises(errors.InsufficientPrivilege):
        ask(Role.API, "DROP TRIGGER phases_follow_boards ON phases")


NEW_BOARD = (
    "INSERT INTO boards (phase_id, protocol_digest, split_revision, number, digest, body_digest, body, "
    "published_at, view) SELECT id, protocol_digest, split_revision, {}, '', '', '', now(), 'main' "
    "FROM phases"
)
SHOW = "UPDATE phases SET current_board_id = (SELECT id FROM boards WHERE number = {})"
SHOW_LATE = "UPDATE phases SET late_board_id = (SELECT id FROM boards WHERE number = {})"
FLIP = (
    "INSERT INTO board_flips (phase_id, board_id, at, news) "
    "SELECT phase_id, id, {}, '{{}}' FROM boards WHERE number = {}"
)


@pytest.mark.usefixtures("pointed")
def test_the_server_shows_the_newest_board_alone_and_says_no_other_history(ask: Ask) -> None:
    """As a reveal and another protocol do; a worker shows what it built."""
    for number in (1, 2):
        ask(Role.WORKER, NEW_BOARD.format(number))
    ask(Role.WORKER, SHOW.format(1))
    ask(Role.WORKER, SHOW_LATE.format(1))
    ask(Role.WORKER, FLIP.format("now()", 1))
    with pytest.raises(errors.InsufficientPrivilege, match="no such board"):
        ask(Role.API, FLIP.format("clock_timestamp()", 2))  # not shown yet
    ask(Role.API, SHOW.format(2))
    for at in ("clock_timestamp() - interval '1 day'", "clock_timestamp() + interval '1 day'"):
        with pytest.raises(errors.InsufficientPrivilege, match="no such board"):
            ask(Role.API, FLIP.format(at, 2))
    ask(Role.API, FLIP.format("clock_timestamp()", 2))
    for statement in (FLIP.format("clock_timestamp()", 2), FLIP.format("clock_timestamp()", 1)):
        with pytest.raises(errors.InsufficientPrivilege, match="no such board"):
            ask(Role.API, statement)
    for statement in (SHOW.format(1), SHOW_LATE.format(2)):
        with pytest.raises(errors.InsufficientPrivilege, match="newest board alone"):
            ask(Role.API, statement)
    ask(Role.API, "UPDATE phases SET late_board_id = NULL")


@pytest.mark.parametrize(("role", "statement"), REFUSED)
def test_what_a_role_must_not_do_is_refused(ask: Ask, role: Role, statement: str) -> None:
    with pytest.raises(errors.InsufficientPrivilege):
        ask(role, statement)


def new_work(kind: str, key: str) -> str:
    return (
        "INSERT INTO work (id, kind, key, state, asked, attempts, fence, created_at, available_at) "
        f"VALUES ('{kind}-{key}', '{kind}', '{key}', 'held', 1, 0, 0, now(), now())"
    )


@pytest.mark.parametrize("kind", WORK_RIGHTS)
@pytest.mark.parametrize("role", Role)
def test_a_role_changes_work_of_its_kinds_alone(
    records_url: str, ask: Ask, role: Role, kind: str
) -> None:
    given = WORK_RIGHTS[kind][list(Role).index(role)]
    with psycopg.connect(records_url.replace("+psycopg", ""), autocommit=True) as owner:
        owner.execute(
            f"ALTER TABLE work DROP CONSTRAINT IF EXISTS needed_for_{kind}"
        )  # rights alone
        owner.execute(new_work(kind, "there"))
    may_insert = "INSERT" in given
    with nullcontext() if may_insert else pytest.raises(errors.InsufficientPrivilege):
        ask(role, new_work(kind, "new"))
    change = f"work SET state = 'dead' WHERE id = '{kind}-there' RETURNING id"
    if "UPDATE" in rights_of(role)["work"]:
        assert (ask(role, f"UPDATE {change}") is not None) == ("UPDATE" in given)
    if "DELETE" in rights_of(role)["work"]:
        gone = ask(role, f"DELETE FROM work WHERE id = '{kind}-there' RETURNING id")
        assert (gone is not None) == ("DELETE" in given)


def test_every_kind_of_work_has_its_rights() -> None:
    assert set(WORK_RIGHTS) == WorkItem.__mapper__.polymorphic_map.keys()


def test_a_role_that_is_there_gets_back_exactly_its_rights(
    records_url: str, ask: Ask, tmp_path: Path
) -> None:
    owner = records_url.replace("+psycopg", "")
    with psycopg.connect(owner, autocommit=True) as connection:
        connection.execute("GRANT ALL ON tokens TO exceptiondrive_worker")
        connection.execute("REVOKE ALL ON work FROM exceptiondrive_worker")
    address = tmp_path / "worker_database_url"
    address.write_text(as_role(records_url, Role.WORKER) + "\n")
    assert grant_to_files(records_url, [address]) == [Role.WORKER]
    assert ask(Role.WORKER, "SELECT count(*) FROM work") == (0,)
    with pytest.raises(errors.InsufficientPrivilege):
        ask(Role.WORKER, "SELECT * FROM tokens")


def test_a_role_that_cannot_sign_in_gets_the_password_of_its_address(
    records_url: str, ask: Ask, tmp_path: Path
) -> None:
    """So a password is changed: in the file of its secret. One that opens is left as it is."""
    owner = records_url.replace("+psycopg", "")
    kept = "SELECT rolpassword FROM pg_authid WHERE rolname = 'exceptiondrive_worker'"
    address = tmp_path / "worker_database_url"
    with psycopg.connect(owner, autocommit=True) as connection:
        connection.execute("ALTER ROLE exceptiondrive_worker PASSWORD NULL")
        url = make_url(as_role(records_url, Role.WORKER)).set(password="changed")
        address.write_text(url.render_as_string(hide_password=False))
        grant_to_files(records_url, [address])
        assert connection.execute(kept).fetchone() == (None,), "this server asks nobody for one"
        connection.execute("ALTER ROLE exceptiondrive_worker NOLOGIN")
        grant_to_files(records_url, [address])
        (digest,) = connection.execute(kept).fetchone() or ("",)
        assert str(digest).startswith("SCRAM-SHA-256$")
        assert ask(Role.WORKER, "SELECT 1") == (1,)
        connection.execute("ALTER ROLE exceptiondrive_worker PASSWORD NULL")


def test_no_role_makes_temporary_tables(records_url: str, ask: Ask, tmp_path: Path) -> None:
    """The right is everybody's by default, and stands at the database, not at its tables."""
    ask(Role.API, "CREATE TEMPORARY TABLE before (id int)")
    address = tmp_path / "api_database_url"
    address.write_text(as_role(records_url, Role.API) + "\n")
    grant_to_files(records_url, [address])
    for role in Role:
        with pytest.raises(errors.InsufficientPrivilege):
            ask(role, "CREATE TEMPORARY TABLE mine (id int)")


def test_no_role_makes_large_objects(ask: Ask) -> None:
    """They stand in no table: whoever took a service over would fill the disk with them."""
    for role in Role:
        for maker in ("lo_create(0)", "lo_creat(-1)", "lo_from_bytea(0, 'x')"):
            with pytest.raises(errors.InsufficientPrivilege):
                ask(role, f"SELECT {maker}")


@pytest.mark.parametrize("user", ["postgres", "somebody", None])
def test_the_owner_and_strangers_are_no_roles(
    records_url: str, tmp_path: Path, user: str | None
) -> None:
    address = tmp_path / "database_url"
    url = make_url(records_url).set(username=user)
    address.write_text(url.render_as_string(hide_password=False))
    with pytest.raises(InvalidRecord, match="exceptiondrive_api"):
        grant_to_files(records_url, [address])


@pytest.mark.parametrize(
    ("program", "command"),
    [
        ("exceptiondrive_worker.operator_cli", "register-splits"),
        ("exceptiondrive_server.operations.cli", "list-tokens"),
    ],
)
def test_a_service_without_its_rights_is_told_who_gives_them(
    records_url: str,
    program: str,
    command: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """So it is after a restore: the tables are new, and nobody's but the owner's."""
    with psycopg.connect(records_url.replace("+psycopg", ""), autocommit=True) as connection:
        connection.execute("REVOKE ALL ON splits, teams FROM exceptiondrive_worker")
    write_sample_split(tmp_path)
    monkeypatch.setenv("EXCEPTIONDRIVE_DATABASE_URL", as_role(records_url, Role.WORKER))
    monkeypatch.setenv("EXCEPTIONDRIVE_SPLITS_DIR", str(tmp_path))
    monkeypatch.setattr("sys.argv", [program, command])
    monkeypatch.setattr("exceptiondrive_worker.operator_cli.set_up_logs", lambda _: None)
    main = importlib.import_module(program).main
    with pytest.raises(SystemExit) as ended:
        main()
    said = capsys.readouterr().err
    assert ended.value.code == 2
    assert "permission denied for table" in said
    assert said.rstrip().endswith("exceptiondrive-server migrate --grant-to FILE")


def test_sqlite_knows_no_roles(sqlite_url: str) -> None:
    with pytest.raises(InvalidRecord, match="SQLite"):
        grant_to_files(sqlite_url, [])
