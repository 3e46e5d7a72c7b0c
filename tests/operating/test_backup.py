"""Backup and restore: what was accepted, scored and said comes back, on either database."""

import gzip
import io
import tarfile
import tempfile
import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path
from typing import Any, Protocol

import pytest
from sqlalchemy import Engine, event, select, update
from tests.chaos.story import Lived, Story
from typer.testing import CliRunner

from exceptiondrive_records.audit.log import verify_audit
from exceptiondrive_records.boards.boards import flip_board
from exceptiondrive_records.boards.tables import BoardFlip, BoardRow
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.migrations import migrate
from exceptiondrive_records.operations.dump import dump_rows, dumped_tables
from exceptiondrive_records.operations.invariants import damaged_uploads, violations
from exceptiondrive_records.operations.troubles import troubles
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.submissions.file_store import FileStore
from exceptiondrive_records.submissions.submissions import accept
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_server.operations.backup import BackupError, restore_backup, write_backup
from exceptiondrive_server.operations.cli import app
from exceptiondrive_server.submissions.receipts import ReceiptSigner


class AddBoard(Protocol):
    def __call__(self, database: Database, body: str | None = None) -> int: ...


@pytest.fixture
def sqlite_path(tmp_path: Path) -> Path:
    """Where a database may be made."""
    return tmp_path / "fresh.sqlite3"


@pytest.fixture
def add_board() -> AddBoard:
    """Append a board like the last one, by its own number; return the id that it got."""

    def add(database: Database, body: str | None = None) -> int:
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
                body=body or last.body,
                published_at=last.published_at,
            )
            session.add(row)
            session.flush()
            return row.id

    return add


@contextmanager
def memory_at_most(limit_bytes: int) -> Iterator[None]:
    """Fail where Python's own objects took more at once."""
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < limit_bytes
    finally:
        tracemalloc.stop()


def all_rows(database: Database) -> dict[str, list[str]]:
    with database.read() as session:
        return {table.name: list(dump_rows(session, table)) for table in dumped_tables()}


def test_a_restored_backup_holds_every_row_and_every_file(
    lived: Lived, empty_database_url: str, tmp_path: Path
) -> None:
    """From SQLite to SQLite, and from SQLite to PostgreSQL: the way from one machine to many."""
    head = write_backup(lived.database, lived.files, tmp_path / "backup.tar")
    files = FileStore((tmp_path / "restored").as_uri())
    restore_backup(tmp_path / "backup.tar", empty_database_url, files)
    restored = Database(empty_database_url)
    assert all_rows(restored) == all_rows(lived.database)
    with restored.read() as session:
        assert violations(session) == []
        assert damaged_uploads(session, files, limit_bytes=2**20) == []
        verdict = verify_audit(session)
        assert (verdict.n_lines, verdict.head) == (head.audit_lines, head.audit_head)
        assert verdict.n_lines > 5
    restored.dispose()


def test_records_of_a_clock_that_was_set_back_are_whole_and_can_be_restored(
    embedded_story: Story, tmp_path: Path
) -> None:
    """What was built before is shown after: by a reveal, an update or a rollback an earlier board again."""
    with embedded_story.database.write() as session:
        later = database_now(session) + timedelta(hours=1)
        session.execute(update(BoardRow).values(published_at=later))
        session.execute(update(BoardFlip).values(at=later))
        phase = session.scalars(select(Phase)).one()
        row, phase.current_board_id = session.scalars(select(BoardRow)).one(), None
        flip = flip_board(session, phase, row)
        assert flip is not None
        assert flip.at < later
    write_backup(embedded_story.database, embedded_story.files, tmp_path / "backup.tar")
    url = f"sqlite:///{tmp_path / 'restored.sqlite3'}"
    restore_backup(tmp_path / "backup.tar", url, FileStore((tmp_path / "restored").as_uri()))


def test_a_restore_says_that_a_new_key_signs_receipts_where_the_former_is_not_put_back(
    lived: Lived, tmp_path: Path
) -> None:
    (former,) = ReceiptSigner(tmp_path / "receipt-key.pem", lived.database).keys()
    write_backup(lived.database, lived.files, tmp_path / "backup.tar")
    data = tmp_path / "new"
    done = CliRunner().invoke(app, ["restore", f"{tmp_path}/backup.tar", "--data", str(data)])
    assert (done.exit_code, "put back the key that signs receipts" in done.stderr) == (0, True)
    restored = Database(f"sqlite:///{data}/records.sqlite3")
    keys = ReceiptSigner(data / "receipt-key.pem", restored).keys()
    restored.dispose()
    assert [(one.key_id == former.key_id, one.is_current) for one in keys] == [
        (True, False),
        (False, True),
    ]


def test_a_submission_that_is_linked_to_one_of_a_later_id_comes_back(
    lived: Lived, empty_database_url: str, tmp_path: Path
) -> None:
    """Ids are random: what is linked to may stand after what links."""
    with lived.database.write() as session:
        first, *_, last = session.scalars(select(Submission).order_by(Submission.id))
        first.linked_to = last.id
        ids = first.id, last.id
    write_backup(lived.database, lived.files, tmp_path / "backup.tar")
    restore_backup(
        tmp_path / "backup.tar", empty_database_url, FileStore((tmp_path / "restored").as_uri())
    )
    restored = Database(empty_database_url)
    with restored.read() as session:
        assert session.get_one(Submission, ids[0]).linked_to == ids[1]
    restored.dispose()


def test_every_table_that_refers_to_itself_is_asked_at_the_end() -> None:
    """Else rows in the order of their keys could not be loaded."""
    inner = [
        key for table in dumped_tables() for key in table.foreign_keys if key.column.table is table
    ]
    assert len(inner) >= 2
    assert [str(key.parent) for key in inner if key.initially != "DEFERRED"] == []


def test_the_restored_records_go_on(
    lived: Lived, empty_database_url: str, tmp_path: Path, add_board: AddBoard
) -> None:
    """Numbers go on after the last one, on both databases."""
    write_backup(lived.database, lived.files, tmp_path / "backup.tar")
    files = FileStore((tmp_path / "restored").as_uri())
    restore_backup(tmp_path / "backup.tar", empty_database_url, files)
    restored = Database(empty_database_url)
    with restored.write() as session:
        taken = accept(
            session,
            team_id=1,
            phase_id="dev",
            method="later",
            file_digest="sha256:" + "a" * 64,
            size_bytes=1,
        )
        assert taken.job_id is not None
    number = add_board(restored)
    with restored.read() as session:
        assert session.get_one(BoardRow, number).id == number
        assert verify_audit(session).is_whole
    restored.dispose()


def test_records_are_verified_as_of_one_moment(
    lived: Lived, empty_database_url: str, tmp_path: Path
) -> None:
    """An upload that comes between two questions breaks nothing."""
    write_backup(lived.database, lived.files, tmp_path / "backup.tar")
    uploads = (tmp_path / "restored").as_uri()
    restore_backup(tmp_path / "backup.tar", empty_database_url, FileStore(uploads))
    restored, late = Database(empty_database_url), iter([True])

    def upload_once(_connection: Any, _cursor: Any, statement: str, *_: Any) -> None:
        is_of_jobs = "FROM work" in statement and "work.is_first" in statement
        if is_of_jobs and next(late, None):
            with restored.write() as session:
                accept(
                    session,
                    team_id=1,
                    phase_id="dev",
                    method="late",
                    file_digest="sha256:" + "a" * 64,
                    size_bytes=1,
                )

    environment = {
        "EXCEPTIONDRIVE_DATABASE_URL": empty_database_url,
        "EXCEPTIONDRIVE_FILE_STORE_URL": uploads,
    }
    event.listen(Engine, "before_cursor_execute", upload_once)
    try:
        done = CliRunner().invoke(app, ["verify", "--no-uploads"], env=environment)
    finally:
        event.remove(Engine, "before_cursor_execute", upload_once)
    restored.dispose()
    assert next(late, None) is None
    assert done.exit_code == 0, done.output


def test_a_backup_is_of_one_moment_and_for_its_owner_alone(lived: Lived, tmp_path: Path) -> None:
    path = tmp_path / "backup.tar"
    write_backup(lived.database, lived.files, path)
    assert path.stat().st_mode & 0o777 == 0o600
    assert [entry.name for entry in tmp_path.glob(".backup*")] == []


def test_its_tables_lie_beside_it_while_it_is_written(
    lived: Lived, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A container's /tmp is memory, and smaller than the boards of some years."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "nowhere"))
    write_backup(lived.database, lived.files, tmp_path / "backup.tar")
    assert [path.name for path in tmp_path.glob("*.tar*")] == ["backup.tar"]


def test_as_much_memory_is_taken_as_the_largest_board_asks_however_many_there_are(
    lived: Lived, add_board: AddBoard, sqlite_path: Path
) -> None:
    """A season has hundreds of boards, of megabytes each; a service may take one gigabyte."""
    board_bytes, path = 2**20, sqlite_path.parent / "backup.tar"
    for _ in range(24):
        add_board(lived.database, "x" * board_bytes)
    with memory_at_most(12 * board_bytes):
        write_backup(lived.database, lived.files, path)
    assert path.stat().st_size < 2 * board_bytes
    with (
        memory_at_most(12 * board_bytes),
        pytest.raises(BackupError, match="dev/2: its body is not"),
    ):
        restore_backup(path, f"sqlite:///{sqlite_path}", FileStore("memory://"))


def test_it_is_not_restored_over_records_that_hold_something(lived: Lived, tmp_path: Path) -> None:
    write_backup(lived.database, lived.files, tmp_path / "backup.tar")
    other = FileStore((tmp_path / "other").as_uri())
    with pytest.raises(BackupError, match=r"not empty.*into a new database"):
        restore_backup(tmp_path / "backup.tar", lived.url, other)
    assert list(other.stored()) == []


def test_a_file_store_that_takes_nothing_is_told_with_what_to_do(
    lived: Lived, tmp_path: Path, sqlite_path: Path
) -> None:
    write_backup(lived.database, lived.files, tmp_path / "backup.tar")
    files = FileStore((tmp_path / "other").as_uri())
    (tmp_path / "other").rmdir()
    (tmp_path / "other").touch()
    with pytest.raises(BackupError, match="says: name a new folder"):
        restore_backup(tmp_path / "backup.tar", f"sqlite:///{sqlite_path}", files)


def test_a_damaged_upload_is_not_backed_up_as_if_it_were_whole(
    lived: Lived, tmp_path: Path
) -> None:
    path = next(path for path in lived.uploads.rglob("*") if path.is_file())
    path.write_bytes(b"other")
    with pytest.raises(Exception, match="damaged"):
        write_backup(lived.database, lived.files, tmp_path / "backup.tar")
    assert not (tmp_path / "backup.tar").exists()


def test_lost_uploads_are_left_out_by_name_where_the_operator_says_so(
    lived: Lived, tmp_path: Path
) -> None:
    missing, damaged, *others = [path for path in lived.uploads.rglob("*") if path.is_file()]
    missing.unlink()
    damaged.write_bytes(b"other")
    environment = {
        "EXCEPTIONDRIVE_DATABASE_URL": lived.url,
        "EXCEPTIONDRIVE_FILE_STORE_URL": lived.uploads.as_uri(),
    }
    backup, data = str(tmp_path / "backup.tar"), tmp_path / "new"
    failed = CliRunner().invoke(app, ["backup", backup], env=environment)
    assert isinstance(failed.exception, BackupError)
    assert "--without-lost" in str(failed.exception)
    assert troubles_of_backups(lived.database) == ["backup_failed"]
    done = CliRunner().invoke(app, ["backup", backup, "--without-lost"], env=environment)
    assert (done.exit_code, troubles_of_backups(lived.database)) == (0, [])
    again = CliRunner().invoke(app, ["restore", backup, "--data", str(data)])
    assert again.exit_code == 0, again.stderr
    for path in (missing, damaged):
        for told in (done.stderr, again.stderr):
            assert f"without sha256:{path.name}, which was lost" in told
    restored = [path.name for path in (data / "uploads").rglob("*") if path.is_file()]
    assert sorted(restored) == sorted(path.name for path in others)


def test_a_backup_says_what_a_restore_of_it_would_refuse(
    embedded_story: Story, tmp_path: Path
) -> None:
    with embedded_story.database.write() as session:
        session.execute(update(Submission).values(method="Renamed"))
    path = tmp_path / "backup.tar"
    environment = {
        "EXCEPTIONDRIVE_DATABASE_URL": str(embedded_story.database.engine.url),
        "EXCEPTIONDRIVE_FILE_STORE_URL": (embedded_story.folder / "uploads").as_uri(),
    }
    done = CliRunner().invoke(app, ["backup", str(path)], env=environment)
    assert done.exit_code == 0
    with pytest.raises(BackupError) as refused:
        restore_backup(path, f"sqlite:///{tmp_path / 'new'}", FileStore("memory://"))
    _, *broken = str(refused.value).splitlines()
    assert len(broken) >= 3
    for line in broken:
        assert f"restore would refuse it: {line}\n" in done.stderr


def test_a_store_that_is_away_is_told_once_with_where_to_learn_more(
    lived: Lived, tmp_path: Path
) -> None:
    """As where nothing is mounted on the folder of uploads."""
    lived.uploads.rename(lived.uploads.with_name("away"))
    lived.uploads.mkdir()
    with lived.database.read() as session:
        (found,) = damaged_uploads(session, lived.files, limit_bytes=2**20)
    assert found.rule == "store unreadable"
    for without_lost in (False, True):
        with pytest.raises(
            BackupError, match=r"No backup was written\. exceptiondrive-server doctor"
        ):
            write_backup(
                lived.database, lived.files, tmp_path / "backup.tar", without_lost=without_lost
            )


def troubles_of_backups(database: Database) -> list[str]:
    with database.read() as session:
        return [one.code for one in troubles(session) if one.subject == "backup"]


def test_a_backup_cut_short_restores_nothing(lived: Lived, sqlite_path: Path) -> None:
    path = sqlite_path.parent / "backup.tar"
    write_backup(lived.database, lived.files, path)
    path.write_bytes(path.read_bytes()[:-12_000])
    files = FileStore((sqlite_path.parent / "restored").as_uri())
    with pytest.raises(BackupError):
        restore_backup(path, f"sqlite:///{sqlite_path}", files)
    with Database(f"sqlite:///{sqlite_path}").read() as session:
        assert session.query(Submission).count() == 0


def test_a_backup_without_uploads_that_ends_between_two_tables_restores_nothing(
    empty_database_url: str, sqlite_path: Path, tmp_path: Path
) -> None:
    """It lacks no file, and its last member is whole."""
    whole, files = tmp_path / "backup.tar", FileStore((tmp_path / "uploads").as_uri())
    migrate(empty_database_url)
    database = Database(empty_database_url)
    write_backup(database, files, whole)
    database.dispose()
    with tarfile.open(whole) as archive:
        ends_at = archive.getmembers()[3].offset
    whole.write_bytes(whole.read_bytes()[:ends_at])
    with pytest.raises(BackupError, match="is not a complete backup"):
        restore_backup(whole, f"sqlite:///{sqlite_path}", files)


def test_a_backup_of_other_columns_is_refused_before_a_file_is_put_anywhere(
    lived: Lived, sqlite_path: Path
) -> None:
    path = sqlite_path.parent / "backup.tar"
    write_backup(lived.database, lived.files, path)
    path.write_bytes(path.read_bytes().replace(b'"confirm_until"', b'"confirm_untie"', 1))
    files = FileStore((sqlite_path.parent / "restored").as_uri())
    with pytest.raises(
        BackupError, match="other columns of submissions than this version: restore"
    ):
        restore_backup(path, f"sqlite:///{sqlite_path}", files)
    assert files.is_empty()
    assert not sqlite_path.exists()


def test_a_changed_row_in_the_backup_is_found(lived: Lived, sqlite_path: Path) -> None:
    """Somebody edits the audit log inside the file, and packs it again."""
    path, edited = sqlite_path.parent / "backup.tar", sqlite_path.parent / "edited.tar"
    write_backup(lived.database, lived.files, path)
    with tarfile.open(path) as source, tarfile.open(edited, "w") as target:
        for member in source:
            data = content(source, member)
            if member.name.startswith("records/"):
                lines = gzip.decompress(data)
                data = gzip.compress(lines.replace(b"submission received", b"submission recEived"))
                member.size = len(data)
            target.addfile(member, io.BytesIO(data))
    files = FileStore((sqlite_path.parent / "restored").as_uri())
    with pytest.raises(BackupError, match="audit chain"):
        restore_backup(edited, f"sqlite:///{sqlite_path}", files)


def content(archive: tarfile.TarFile, member: tarfile.TarInfo) -> bytes:
    stream = archive.extractfile(member)
    assert stream is not None
    return stream.read()


@pytest.mark.parametrize("at", [0, 12, 40, -6])
def test_damaged_rows_in_the_backup_are_told(lived: Lived, sqlite_path: Path, at: int) -> None:
    path = sqlite_path.parent / "backup.tar"
    write_backup(lived.database, lived.files, path)
    with tarfile.open(path) as archive:
        member = archive.getmember("records/submissions.jsonl.gz")
    data = bytearray(path.read_bytes())
    data[member.offset_data + at % member.size] ^= 0xFF
    path.write_bytes(data)
    files = FileStore((sqlite_path.parent / "restored").as_uri())
    with pytest.raises(BackupError, match="is not a complete backup"):
        restore_backup(path, f"sqlite:///{sqlite_path}", files)


def test_what_is_no_backup_is_refused(sqlite_path: Path) -> None:
    path = sqlite_path.parent / "notes.txt"
    path.write_text("hello")
    with pytest.raises(BackupError, match="not a complete backup"):
        restore_backup(path, f"sqlite:///{sqlite_path}", FileStore("memory://"))


def test_a_backup_whose_head_is_nested_too_deeply_is_refused(sqlite_path: Path) -> None:
    path = sqlite_path.parent / "deep.tar"
    head = b"[" * 50_000
    with tarfile.open(path, "w") as archive:
        member = tarfile.TarInfo("backup.json")
        member.size = len(head)
        archive.addfile(member, io.BytesIO(head))
    with pytest.raises(BackupError, match="head of the backup cannot be read"):
        restore_backup(path, f"sqlite:///{sqlite_path}", FileStore("memory://"))
