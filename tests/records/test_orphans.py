"""Orphaned files are swept; a file of an accepted upload never is, whatever happens at once."""

import os
import threading
import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import select, update
from tests.support.records import count_audit_lines
from typer.testing import CliRunner

from exceptiondrive_records.audit.tables import AuditLine
from exceptiondrive_records.operations import garbage
from exceptiondrive_records.operations.garbage import (
    UnknownFiles,
    orphans_were_left,
    remove_orphan,
    run_sweeper,
    sweep_orphans,
)
from exceptiondrive_records.operations.troubles import troubles
from exceptiondrive_records.submissions.file_store import FileStore, is_kept
from exceptiondrive_records.submissions.submissions import accept
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_server.operations.cli import app

World = Any
HOUR = timedelta(hours=1)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "uploads"


@pytest.fixture
def files(folder: Path) -> FileStore:
    return FileStore(folder.as_uri())


def store(files: FileStore, data: bytes) -> str:
    digest, _ = files.put_stream([data], limit_bytes=1000)
    return digest


def grow_old(folder: Path, digest: str, hours: float = 48) -> None:
    then = time.time() - hours * 3600
    os.utime(folder / digest[7:9] / digest[7:], (then, then))


def take(world: World, digest: str, before: Callable[[Any], None] = lambda _: None) -> None:
    """What the server does once the file is stored."""
    with world.database.write() as session:
        before(session)
        accept(
            session,
            team_id=world.team_id,
            phase_id="dev",
            method="m",
            file_digest=digest,
            size_bytes=1,
        )


def sweep(world: World, files: FileStore) -> int:
    return sweep_orphans(world.database, files, actor="test", grace=24 * HOUR).n_files


def test_old_orphans_go_and_all_else_stays(world: World, files: FileStore, folder: Path) -> None:
    mentioned, refused, young = (store(files, data) for data in (b"taken", b"refused", b"young"))
    take(world, mentioned)
    for digest in (mentioned, refused):
        grow_old(folder, digest)
    (folder / "notes.txt").write_text("an operator's own")
    assert sweep(world, files) == 1
    assert [files.holds(digest) for digest in (mentioned, refused, young)] == [True, False, True]
    assert (folder / "notes.txt").exists()
    assert sweep(world, files) == 0
    with world.database.read() as session:
        lines = session.scalars(select(AuditLine).where(AuditLine.subject == "file store"))
        assert [line.detail for line in lines] == [{"n_files": 1, "n_bytes": len(b"refused")}]


def test_the_same_bytes_sent_again_are_young_again(
    world: World, files: FileStore, folder: Path
) -> None:
    digest = store(files, b"again")
    grow_old(folder, digest)
    store(files, b"again")
    assert sweep(world, files) == 0
    sent_at = files.changed_at(digest)
    assert sent_at is not None
    assert not remove_orphan(world.database, files, digest, before=sent_at), "sent since it looked"
    assert remove_orphan(world.database, files, digest, before=sent_at + HOUR)


def test_a_sweep_between_storing_and_recording_loses_nothing(
    world: World, files: FileStore, folder: Path
) -> None:
    digest = store(files, b"raced")
    grow_old(folder, digest)
    assert sweep(world, files) == 1

    def store_again(session: Any) -> None:
        assert not is_kept(session, files, digest)
        store(files, b"raced")

    take(world, digest, store_again)
    assert files.holds(digest)


def test_a_sweep_waits_for_an_upload_that_has_looked(
    world: World, files: FileStore, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The upload has proven the file to be there; the sweep wants to remove it just then."""
    digest = store(files, b"raced")
    grow_old(folder, digest)
    swept: list[int] = []
    looks = threading.Event()
    look = garbage.remove_orphan

    def tell_and_look(*arguments: Any, **options: Any) -> bool:
        looks.set()
        return look(*arguments, **options)

    monkeypatch.setattr(garbage, "remove_orphan", tell_and_look)
    sweeper = threading.Thread(target=lambda: swept.append(sweep(world, files)))

    def begin_sweep(session: Any) -> None:
        assert is_kept(session, files, digest)
        sweeper.start()
        assert looks.wait(30)
        sweeper.join(0.3)
        assert sweeper.is_alive(), "the sweep waits for this transaction"

    take(world, digest, begin_sweep)
    sweeper.join(30)
    assert swept == [0]
    assert files.holds(digest)


def test_of_all_reconcilers_one_sweeps(world: World, files: FileStore, folder: Path) -> None:
    grow_old(folder, store(files, b"refused"))
    stop = threading.Event()
    threads = [
        threading.Thread(target=run_sweeper, args=(world.database, files, stop)) for _ in range(2)
    ]
    for thread in threads:
        thread.start()
    while count(world) == 0:
        time.sleep(0.02)
    stop.set()
    for thread in threads:
        thread.join(30)
    assert count(world) == 1


def test_beside_a_database_that_is_older_nothing_is_removed_but_by_hand(
    world: World, files: FileStore, folder: Path
) -> None:
    """As after a restore into the store that has later uploads, some sent the night before."""
    for number in range(6):
        grow_old(folder, store(files, b"%d" % number), hours=48 if number < 3 else 2)
    automatic = partial(
        sweep_orphans, world.database, files, actor="reconciler", at_most=garbage._BY_ITSELF
    )
    for _ in range(2):
        with pytest.raises(UnknownFiles, match="6 stored files"):
            automatic()
    assert len(list(files.stored())) == 6
    with world.database.read() as session:
        assert count_audit_lines(session, "orphaned files left") == 1
        (found,) = [one for one in troubles(session) if one.code == "files_without_record"]
    words = found.do.partition("exceptiondrive-server ")[2].split()
    settings = {"DATABASE_URL": str(world.database.engine.url), "FILE_STORE_URL": folder.as_uri()}
    done = CliRunner().invoke(
        app, words, env={f"EXCEPTIONDRIVE_{name}": value for name, value in settings.items()}
    )
    assert done.exit_code == 0, done.stderr
    assert list(files.stored()) == []
    assert automatic().n_files == 0
    with world.database.read() as session:
        assert not orphans_were_left(session)


def test_files_that_were_not_confirmed_are_known_and_go_however_many(
    world: World, files: FileStore, folder: Path
) -> None:
    for number in range(garbage._BY_ITSELF + 1):
        digest = store(files, b"%d" % number)
        take(world, digest)
        grow_old(folder, digest)
    with world.database.write() as session:
        session.execute(update(Submission).values(confirm_until=datetime(2020, 1, 1, tzinfo=UTC)))
    swept = sweep_orphans(world.database, files, actor="reconciler", at_most=garbage._BY_ITSELF)
    assert swept.n_files == 4


def test_what_a_crash_leaves_and_uploads_under_way_hinder_no_sweep(
    world: World, files: FileStore, folder: Path
) -> None:
    for number in range(3):
        grow_old(folder, store(files, b"crash %d" % number))
    for number in range(5):
        store(files, b"under way %d" % number)
    stop = threading.Event()
    thread = threading.Thread(target=run_sweeper, args=(world.database, files, stop))
    thread.start()
    while count(world) == 0:
        time.sleep(0.02)
    stop.set()
    thread.join(30)
    assert len(list(files.stored())) == 5


def count(world: World) -> int:
    with world.database.read() as session:
        return count_audit_lines(session, "orphaned files swept")


def test_a_store_that_is_away_ends_no_reconciler(
    world: World, files: FileStore, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder.rmdir()
    folder.write_text("not a folder")
    for name in ("SWEEP_EVERY_S", "_POLL_EVERY_S"):
        monkeypatch.setattr(garbage, name, 0.05)
    stop = threading.Event()
    thread = threading.Thread(target=run_sweeper, args=(world.database, files, stop))
    thread.start()
    thread.join(0.5)
    assert thread.is_alive()
    stop.set()
    thread.join(30)
