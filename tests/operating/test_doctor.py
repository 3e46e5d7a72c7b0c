"""The doctor finds what is wrong, says what to do, and has nothing to say of a healthy server."""

import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from datetime import datetime, timedelta, tzinfo
from pathlib import Path
from typing import Any, Self

import pytest
import redis
from sqlalchemy import inspect, make_url, select, text
from sqlalchemy.exc import DBAPIError
from tests.chaos.story import Lived
from tests.support.broker import PrivateBroker
from tests.support.databases import POSTGRES_ALONE, as_role, read_only
from tests.support.forked import Forked
from tests.support.processes import plain_environment, wait_until

from exceptiondrive_records.audit.log import audit_page
from exceptiondrive_records.boards.tables import BoardEntryRow
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.database import Database, is_forbidden, sentence_of
from exceptiondrive_records.db.errors import Conflict
from exceptiondrive_records.db.roles import Role
from exceptiondrive_records.migrations import migrate
from exceptiondrive_records.participation.changes import change_team
from exceptiondrive_records.submissions.file_store import FileStore
from exceptiondrive_records.submissions.tables import ScoreSheetRow, Submission
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.work.heartbeats import beat
from exceptiondrive_records.work.lease import take_lead
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_server.launcher.broker import broker_command, find_broker_binary, socket_path
from exceptiondrive_server.operations import doctor
from exceptiondrive_server.operations.cli import main
from exceptiondrive_server.operations.doctor import GUARDS, Finding, Severity, examine
from exceptiondrive_server.web.metrics import RequestMetrics, exposition
from exceptiondrive_server.web.settings import ServerSettings

BIN = Path(sys.executable).parent
ROOT = Path(__file__).parents[2]


@pytest.fixture
def healthy(lived: Lived, broker: Any) -> ServerSettings:
    """A server with all its parts, and their signs of life."""
    lived.uploads.chmod(0o700)
    lived.uploads.parent.chmod(0o700)
    with lived.database.write() as session:
        beat(session, "worker", tuple(Lane))
        take_lead(session, "reconciler", "somebody", 60)
    return ServerSettings(
        database_url=lived.url,
        broker_url=broker.url,
        file_store_url=lived.uploads.as_uri(),
        receipt_key_file=lived.uploads.parent / "receipt-key.pem",
    )


def troubles(settings: ServerSettings, *withheld: Path) -> list[Finding]:
    found = examine(settings, withheld)
    return [finding for finding in found if finding.severity is not Severity.OK]


def whats(settings: ServerSettings, *withheld: Path) -> str:
    return " | ".join(finding.what for finding in troubles(settings, *withheld))


def test_it_finds_nothing_wrong_with_a_healthy_server(healthy: ServerSettings) -> None:
    assert troubles(healthy) == []


def test_an_older_scorer_beside_a_newer_one_is_named(healthy: ServerSettings, lived: Lived) -> None:
    with lived.database.write() as session:
        beat(session, "worker", tuple(Lane), scorer_version="1")
    assert troubles(healthy) == []
    with lived.database.write() as session:
        beat(session, "another", scorer_version="2")
    assert whats(healthy) == "workers run scorer 1 beside 2: the older ones score nothing"


def test_a_board_with_sheets_of_two_scorers_is_named(healthy: ServerSettings, lived: Lived) -> None:
    with lived.database.write() as session:
        entry = session.scalars(select(BoardEntryRow).limit(1)).one()
        sheet = session.scalars(select(ScoreSheetRow).limit(1)).one()
        columns = inspect(ScoreSheetRow).columns.keys()
        later = {key: getattr(sheet, key) for key in columns} | {"scorer_version": "2"}
        without = select(Submission.id).where(Submission.status != SubmissionStatus.SCORED)
        later["submission_id"] = session.scalars(without).one()
        session.add(ScoreSheetRow(**later))
        session.add(BoardEntryRow(board_id=entry.board_id, submission_id=later["submission_id"]))
    (finding,) = troubles(healthy)
    assert finding.what == "the board of phase dev has sheets of scorers 1, 2"
    assert "rescore to it" in finding.do


def test_a_clock_that_is_off_is_named_with_its_direction(
    healthy: ServerSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Ahead(datetime):
        @classmethod
        def now(cls, tz: tzinfo | None = None) -> Self:
            return super().now(tz) + timedelta(hours=1)

    monkeypatch.setattr(doctor, "datetime", Ahead)
    (finding,) = troubles(healthy)
    assert re.fullmatch(r"this machine's clock is \+3\d{3}\.\d s from the database's", finding.what)


def test_names_that_were_taken_before_they_looked_alike_are_named_and_stay(
    healthy: ServerSettings, lived: Lived
) -> None:
    with lived.database.write() as session:
        for slug, name in (("bob", "Bob"), ("other", "\u0412ob")):  # a Cyrillic capital
            made = {"is_reference": False, "created_at": database_now(session)}
            session.add(Team(slug=slug, name=name, name_skeleton=slug, **made))
            session.flush()
    assert whats(healthy) == "teams have names that look alike: Bob, \u0412ob"
    with lived.database.write() as session:
        change_team(session, "other", name="\u0412ob", reason="why", actor="test")
    with lived.database.write() as session, pytest.raises(Conflict):
        change_team(session, "other", name="B\u043eb", reason="why", actor="test")


def test_every_trouble_says_what_to_do(tmp_path: Path) -> None:
    settings = ServerSettings(
        database_url=f"sqlite:///{tmp_path / 'none.sqlite3'}",
        broker_url="redis://127.0.0.1:1/0",
        file_store_url=(tmp_path / "uploads").as_uri(),
    )
    found = troubles(settings)
    assert {Severity.WARNING, Severity.ERROR} <= {finding.severity for finding in found}
    assert all(finding.do for finding in found)


def test_records_that_lack_a_column_are_an_error_and_no_outage(
    healthy: ServerSettings, lived: Lived
) -> None:
    with lived.database.write() as session:
        session.execute(text("ALTER TABLE submissions DROP COLUMN confirm_until"))
    (finding,) = troubles(healthy)
    assert finding.severity is Severity.ERROR
    assert finding.what.startswith("the records lack submissions.confirm_until: ")
    with pytest.raises(DBAPIError) as raised, lived.database.read() as session:
        session.scalars(select(Submission)).all()
    assert is_forbidden(raised.value)
    assert "another version made these records" in sentence_of(raised.value)


def test_the_private_broker_of_a_data_folder_is_found(tmp_path: Path) -> None:
    said = doctor_of(tmp_path)
    assert "the broker does not answer" in said
    assert "start the server, if the broker is its own" in said
    (tmp_path / "broker").mkdir(mode=0o700)
    command = broker_command(find_broker_binary(), tmp_path / "broker")
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
        wait_until(socket_path(tmp_path / "broker").exists)
        said = doctor_of(tmp_path)
        process.terminate()
    assert "the broker answers and evicts nothing" in said


def test_of_a_stopped_run_its_one_command_is_advised_not_the_single_processes(
    tmp_path: Path,
) -> None:
    migrate(f"sqlite:///{tmp_path / 'records.sqlite3'}")
    said = doctor_of(tmp_path)
    for what in ("No worker is alive", "No reconciler leads"):
        (after,) = said.split(what)[1:]
        assert after.splitlines()[1].startswith(
            f"          -> start its server: exceptiondrive-server run --data {tmp_path}"
        ), said
    assert "exceptiondrive-worker run" not in said


def be_doctor(words: Sequence[str]) -> None:
    """Be the command, as the user who is named first."""
    redis.Redis()  # imports more while it can read: another user may not enter this Python
    if (user := int(words[0])) != os.getuid():
        os.setgroups([])
        os.setgid(user)
        os.setuid(user)
    sys.argv = ["exceptiondrive-server", "doctor", *words[1:]]
    main()


def doctor_of(data: Path, *words: str, user: int = os.getuid(), **settings: str) -> str:
    """What the command says of a data folder that lacks much, to a user of the machine."""
    asked = [str(user), "--data", str(data), *words]
    with tempfile.NamedTemporaryFile("r") as log:
        code = Forked(be_doctor, asked, plain_environment(**settings), Path(log.name)).wait(60)
        said = log.read()
    assert code == 1, said
    return said


def doctor_as(user: int, *words: str, **settings: str) -> str:
    """What the command says to a user of the machine where there are no records."""
    away = {"EXCEPTIONDRIVE_BROKER_URL": "redis+socket:///nowhere/broker.sock"}
    return doctor_of(Path("/nowhere"), *words, user=user, **away, **settings)


def test_a_broker_that_evicts_is_named(healthy: ServerSettings, broker: Any) -> None:
    with broker.client() as client:
        client.config_set("maxmemory-policy", "allkeys-lru")
    assert "allkeys-lru" in whats(healthy)


def test_a_broker_that_asks_for_another_password_is_there(
    healthy: ServerSettings, broker: Any
) -> None:
    with broker.client() as client:
        client.config_set("requirepass", "another")
        (finding,) = troubles(healthy)
        client.config_set("requirepass", "")
    assert finding.severity is Severity.WARNING
    assert finding.what.startswith("the broker expects another password than ")


def test_a_broker_that_tells_nothing_of_its_settings_answers_all_the_same(
    healthy: ServerSettings, broker: Any
) -> None:
    said = "the broker answers, but does not say whether it evicts anything"
    with broker.client() as client:
        client.execute_command("ACL", "SETUSER", "default", "-config")
    assert troubles(healthy) == []
    assert said in [finding.what for finding in examine(healthy)]
    broker.kill()
    command = broker_command(find_broker_binary(), broker.folder)
    without = PrivateBroker(broker.folder, [*command, "--rename-command", "CONFIG", ""])
    assert troubles(healthy) == []
    assert said in [finding.what for finding in examine(healthy)]
    without.kill()


def test_a_broker_that_is_away_is_a_warning_not_an_error(
    healthy: ServerSettings, broker: Any
) -> None:
    broker.kill()
    (finding,) = troubles(healthy)
    assert finding.severity is Severity.WARNING
    assert "nothing is lost" in finding.what


def test_uploads_that_everyone_may_read_are_an_error(healthy: ServerSettings, lived: Lived) -> None:
    lived.uploads.chmod(0o755)
    (finding,) = troubles(healthy)
    assert finding.severity is Severity.ERROR
    assert finding.do == f"run: chmod o-rwx {lived.uploads}"


def test_a_folder_of_uploads_that_is_not_there_is_named_and_not_made(
    healthy: ServerSettings, tmp_path: Path
) -> None:
    folder = tmp_path / "mistyped"
    said = whats(healthy.model_copy(update={"file_store_url": folder.as_uri()}))
    assert said == f"there is no folder {folder} that this user may see"
    assert not folder.exists()


def test_an_empty_folder_of_uploads_that_the_records_mention_is_an_error(
    healthy: ServerSettings, lived: Lived
) -> None:
    lived.uploads.rename(lived.uploads.with_name("away"))
    lived.uploads.mkdir(mode=0o700)
    (finding,) = troubles(healthy)
    assert finding.severity is Severity.ERROR
    assert finding.what == (
        f"{lived.uploads} is empty, but the records mention uploads: new ones are refused"
    )


def test_a_receipt_key_that_is_none_is_named_before_somebody_asks_for_a_receipt(
    healthy: ServerSettings,
) -> None:
    healthy.receipt_key_file.write_text("no key")
    (finding,) = troubles(healthy)
    assert finding.severity is Severity.ERROR
    assert str(healthy.receipt_key_file) in finding.what


@pytest.mark.skipif(os.getuid() != 0, reason="only root can become another user")
def test_a_store_and_a_place_of_the_receipt_key_of_another_user_are_named(
    open_folder: Path,
) -> None:
    """As after a restore whose files were left to their owner, and where `etc/` is root's."""
    store = open_folder / "uploads"
    store.mkdir(mode=0o700)
    key = open_folder / "receipt.pem"
    said = doctor_as(
        20001,
        EXCEPTIONDRIVE_FILE_STORE_URL=store.as_uri(),
        EXCEPTIONDRIVE_RECEIPT_KEY_FILE=str(key),
    )
    assert f"error   this user may not enter {store}, which is of user 0" in said
    assert f"there is no key {key}, and this user cannot create one there" in said
    assert not key.exists()


def test_the_settings_of_the_server_are_examined(tmp_path: Path) -> None:
    done = subprocess.run(
        [BIN / "exceptiondrive-server", "doctor", "--data", str(tmp_path)],
        env=plain_environment() | {"EXCEPTIONDRIVE_TRUSTED_PROXIES": "172.30.250.1/24"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert (
        "EXCEPTIONDRIVE_TRUSTED_PROXIES: '172.30.250.1/24' is no address and no network"
        in done.stderr
    )


def test_missing_workers_and_reconcilers_are_named(healthy: ServerSettings, lived: Lived) -> None:
    with lived.database.write() as session:
        session.execute(text("DELETE FROM worker_heartbeats"))
        session.execute(text("DELETE FROM work WHERE kind = 'lead'"))
        take_lead(session, "sweep", "somebody", 60)
    assert whats(healthy) == (
        "No worker is alive: nothing is scored. Nothing is lost meanwhile. | No reconciler leads: webhooks, "
        "mail and rescoring wait, and lost work is not found again."
    )


def test_an_old_queue_is_named(healthy: ServerSettings, lived: Lived) -> None:
    with lived.database.write() as session:
        statement = "UPDATE work SET state = 'queued', created_at = '2026-01-01 00:00:00.000000'"
        session.execute(text(statement))
    assert "the oldest submission in the lane live has waited for" in whats(healthy)
    with lived.database.write() as session:
        session.execute(text("UPDATE work SET lane = 'rescore' WHERE lane IS NOT NULL"))
    assert "oldest submission" not in whats(healthy)


def test_records_without_their_guards_are_an_error(healthy: ServerSettings, lived: Lived) -> None:
    with lived.database.write() as session:
        session.execute(text("DROP TRIGGER score_sheets_no_update"))
    (finding,) = troubles(healthy)
    assert finding.severity is Severity.ERROR
    assert finding.what.endswith("are gone or disabled: score_sheets_no_update")


def test_it_knows_every_guard(database: Database) -> None:
    dialect = database.engine.dialect.name
    listing = {
        "sqlite": "SELECT name FROM sqlite_master WHERE type = 'trigger'",
        "postgresql": "SELECT tgname FROM pg_trigger WHERE tgfoid = 'refuse_change'::regproc",
    }[dialect]
    with database.read() as session:
        assert GUARDS[dialect] == set(session.scalars(text(listing)))


@POSTGRES_ALONE
def test_guards_that_are_disabled_are_an_error(healthy: ServerSettings, database_url: str) -> None:
    """As a copy with `--disable-triggers` leaves them where it breaks off."""
    migrate(database_url)
    settings = healthy.model_copy(update={"database_url": database_url})
    assert "append-only" not in whats(settings)
    database = Database(database_url)
    with database.write() as session:
        session.execute(text("ALTER TABLE audit_lines DISABLE TRIGGER ALL"))
    database.dispose()
    assert "append-only are gone or disabled: audit_lines_append_only" in whats(settings)


def test_what_the_database_said_is_told(healthy: ServerSettings, database_url: str) -> None:
    """One that refuses a name or a right answers: to look for it in the network would be in vain."""
    if database_url.startswith("sqlite"):
        Path(database_url.removeprefix("sqlite:///")).write_bytes(b"no database" * 100)
        settings = healthy.model_copy(update={"database_url": database_url})
        assert "file is not a database; the records are damaged" in whats(settings)
        return
    nobody = make_url(database_url).set(username="nobody").render_as_string(hide_password=False)
    assert 'role "nobody" does not exist' in whats(
        healthy.model_copy(update={"database_url": nobody})
    )
    database = Database(database_url)
    with database.write() as session:
        session.execute(text(f"REVOKE ALL ON work FROM {Role.API}"))
    database.dispose()
    settings = healthy.model_copy(update={"database_url": as_role(database_url, Role.API)})
    said = whats(settings)
    assert "permission denied for table work" in said
    assert "migrate --grant-to FILE" in said


def test_records_that_are_read_only_are_an_error(
    healthy: ServerSettings, database_url: str
) -> None:
    migrate(database_url)
    settings = healthy.model_copy(update={"database_url": database_url})
    database = Database(database_url)
    try:
        with read_only(database):
            found = troubles(settings)
    finally:
        database.dispose()
    (finding,) = (each for each in found if each.severity is Severity.ERROR)
    assert finding.what == "the records can be read but not written: uploads are refused"


def test_an_old_schema_is_an_error(healthy: ServerSettings, empty_database_url: str) -> None:
    path = empty_database_url.removeprefix("sqlite:///")
    if path != empty_database_url:
        Path(path).touch()
    settings = healthy.model_copy(update={"database_url": empty_database_url})
    (finding,) = troubles(settings)
    assert "older schema" in finding.what
    assert "migrate" in finding.do


@pytest.mark.skipif(os.getuid() != 0, reason="only root can become another user")
def test_a_wall_that_stands_and_one_that_does_not(open_folder: Path) -> None:
    withheld = open_folder / "splits"
    withheld.mkdir(mode=0o700)
    (withheld / "name").mkdir(mode=0o755)
    os.chown(withheld, 20002, 20002)
    for closed in (withheld, withheld / "name"):
        assert f"ok      this user cannot enter {closed}" in doctor_as(
            20001, "--withheld", str(closed)
        )
    for mode in (0o755, 0o711, 0o744):
        withheld.chmod(mode)
        said = doctor_as(20001, "--withheld", str(withheld))
        assert f"error   this user may read {withheld}" in said
        assert f"chmod 0700 {withheld}" in said
    withheld.chmod(0o700)
    said = doctor_as(20002, "--withheld", str(withheld))
    assert "-> run server and workers as different users" in said
    said = doctor_as(20001, "--withheld", str(open_folder / "nope"))
    assert f"error   there is no {open_folder}/nope: nothing was examined" in said


@pytest.mark.skipif(os.getuid() != 0, reason="root alone may enter every folder")
def test_root_is_told_that_it_cannot_tell_and_no_more(
    healthy: ServerSettings, open_folder: Path
) -> None:
    (finding,) = troubles(healthy, open_folder)
    assert finding.severity is Severity.WARNING
    assert finding.do == "run the doctor as the server's user"


def test_the_command_ends_with_1_on_errors(tmp_path: Path) -> None:
    done = subprocess.run(
        [BIN / "exceptiondrive-server", "doctor", "--data", str(tmp_path)],
        env=plain_environment(),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1, done.stderr
    assert "-> run: exceptiondrive-server migrate" in done.stdout


def test_a_disk_that_is_low_is_a_warning_and_one_that_refuses_uploads_an_error(
    healthy: ServerSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    for free_bytes, severity, words in (
        (63 << 20, Severity.ERROR, "less than 64 MiB is free"),
        (65 << 20, Severity.WARNING, "less than 1 GiB is free"),
    ):
        monkeypatch.setattr(FileStore, "free_bytes", lambda _, free=free_bytes: free)
        (found,) = troubles(healthy)
        assert found.severity is severity
        assert found.what.startswith(words)
        assert "refused" in found.what


def test_backup_restore_and_verify_by_command(lived: Lived, tmp_path: Path) -> None:
    def run(*arguments: str, **settings: str) -> "subprocess.CompletedProcess[str]":
        return subprocess.run(
            [BIN / "exceptiondrive-server", *arguments],
            env=plain_environment(**settings),
            capture_output=True,
            text=True,
            check=False,
        )

    ours = {
        "EXCEPTIONDRIVE_DATABASE_URL": lived.url,
        "EXCEPTIONDRIVE_FILE_STORE_URL": lived.uploads.as_uri(),
    }
    backup = str(tmp_path / "backup.tar")
    done = run("backup", backup, **ours)
    assert done.returncode == 0, done.stderr
    with lived.database.read() as session:
        (noted,) = audit_page(session, action="backup written")
    told = exposition(RequestMetrics(), lived.database).decode()
    last = re.search(r"^exceptiondrive_last_backup_timestamp_seconds (.+)$", told, re.MULTILINE)
    assert last is not None
    assert float(last[1]) == pytest.approx(noted.at.timestamp(), abs=1)
    done = run("restore", backup, "--data", str(tmp_path / "new"))
    assert done.returncode == 0, done.stderr
    done = run("verify", "--data", str(tmp_path / "new"))
    assert done.returncode == 0, done.stderr
    assert "every invariant holds" in done.stderr
    stored = next(path for path in (tmp_path / "new/uploads").rglob("*") if path.is_file())
    stored.unlink()
    done = run("verify", "--data", str(tmp_path / "new"))
    assert done.returncode == 2
    with lived.database.read() as session:
        whose = select(Submission.id).where(Submission.file_digest == f"sha256:{stored.name}")
        named = ", ".join(sorted(session.scalars(whose)))
    assert f"upload missing: sha256:{stored.name}: the file of {named}\n" == done.stdout
    section = "broken invariants"
    assert f"1 broken invariant; see `{section}` in docs/operating.md" in done.stderr
    done = run("backup", str(tmp_path / "none.tar"), "--data", str(tmp_path / "new"))
    assert done.returncode == 2
    assert (
        f"No backup was written. exceptiondrive-server verify says whose file it is; see `{section}`"
        in done.stderr
    )
    assert not (tmp_path / "none.tar").exists()
    put_back = re.search(r"`(tar -xO[^`]+)`", (ROOT / "docs/operating.md").read_text("utf-8"))
    assert put_back is not None
    words = put_back[1].replace("BACKUP.tar", backup).replace("HEX", stored.name)
    stored.write_bytes(subprocess.check_output(words.split()))
    assert run("verify", "--data", str(tmp_path / "new")).returncode == 0
    done = run("backup", str(tmp_path))
    assert "is a directory" in " ".join(done.stderr.replace("│", " ").split())
