"""Faults of records alone: many writers, an interrupted migration, a restore."""

import dataclasses
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from sqlalchemy import func, select
from tests.chaos.checker import check
from tests.chaos.postgres import Postgres
from tests.chaos.run import Run, percentile
from tests.support.records import count_audit_lines

from exceptiondrive_records.audit.log import verify_audit
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.migrations import is_current, migrate
from exceptiondrive_records.submissions.file_store import FileStore
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_server.operations.backup import restore_backup, write_backup

_WRITER = """
import sys, time
from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.db.database import Database
database = Database(sys.argv[1])
with database.read() as session:
    session.connection()  # the first use of all prepares much
print("ready", flush=True)
sys.stdin.readline()
for number in range(60):
    began = time.monotonic()
    with database.write() as session:
        audit(session, f"writer:{sys.argv[2]}", "wrote", str(number))
    print(began, time.monotonic())
"""
_MIGRATION = """
import os, signal, sys
from sqlalchemy import event
from exceptiondrive_records.db import database
from exceptiondrive_records.migrations import migrate
from sqlalchemy.engine import Engine
seen = 0
@event.listens_for(Engine, "after_cursor_execute")
def count(connection, cursor, statement, parameters, context, executemany):
    global seen
    seen += statement.lstrip().upper().startswith("CREATE TABLE")
    if seen == int(sys.argv[2]):
        os.kill(os.getpid(), signal.SIGKILL)
migrate(sys.argv[1])
"""


def six_writers() -> str:
    """Every transaction of six processes is kept, in one unbroken chain."""
    folder = Path(tempfile.mkdtemp(prefix="ed-chaos-"))
    url = f"sqlite:///{folder / 'records.sqlite3'}"
    migrate(url)
    writers = [
        subprocess.Popen(
            [sys.executable, "-c", _WRITER, url, str(number)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        for number in range(6)
    ]
    began = time.monotonic()
    _let_go(writers)
    said = [writer.communicate() for writer in writers]
    took_s, errors = time.monotonic() - began, [error for _, error in said]
    spans_s = [[tuple(map(float, line.split())) for line in out.splitlines()] for out, _ in said]
    waits_s = [end - begin for spans in spans_s for begin, end in spans]
    database = Database(url)
    with database.read() as session:
        n_lines, verdict = count_audit_lines(session, "wrote"), verify_audit(session)
    database.dispose()
    shutil.rmtree(folder)
    assert not any(errors), errors
    all_at_once = min(spans[-1][1] for spans in spans_s) > max(spans[0][0] for spans in spans_s)
    assert all_at_once, "one had ended before another began"
    assert n_lines == 360, f"{n_lines} of 360 lines"
    assert verdict.is_whole, "the chain is broken"
    # printed, not judged: with six that write without a pause, it tells of cores and disk
    p50_ms, p99_ms = (percentile(waits_s, share) * 1000 for share in (0.5, 0.99))
    told = f"0 locked, p50 {p50_ms:.0f} ms, p99 {p99_ms:.0f} ms, chain whole"
    return f"360 of 360 transactions in {took_s:.1f} s, {told}"


def _let_go(writers: list["subprocess.Popen[bytes]"]) -> None:
    """Let all begin at once, when all are ready."""
    for writer in writers:
        assert writer.stdout is not None
        assert writer.stdout.readline() == b"ready\n", writer.communicate()
    for writer in writers:
        assert writer.stdin is not None
        writer.stdin.write(b"\n")
        writer.stdin.flush()


def kill_migration() -> str:
    """SIGKILL after the third and the ninth table: nothing of it stays, and again works."""
    states = []
    for after in ("3", "9"):
        folder = Path(tempfile.mkdtemp(prefix="ed-chaos-"))
        url = f"sqlite:///{folder / 'records.sqlite3'}"
        done = subprocess.run([sys.executable, "-c", _MIGRATION, url, after], check=False)
        assert done.returncode == -signal.SIGKILL, f"it was not killed: {done.returncode}"
        database = Database(url)
        assert not is_current(database)
        with database.read() as session:
            count = "SELECT count(*) FROM sqlite_master WHERE type = 'table'"
            states.append(session.connection().exec_driver_sql(count).scalar())
        migrate(url)
        assert is_current(database), "it cannot be migrated any more"
        database.dispose()
        shutil.rmtree(folder)
    assert states == [0, 0], f"half a schema stayed: {states} tables"
    return "no table of it stayed, both times; the next migrate finished"


def kill_migration_on_postgres() -> str:
    """The same on PostgreSQL, where nobody else holds the schema up either."""
    server = Postgres()
    try:
        for after in ("3", "9"):
            command = [sys.executable, "-c", _MIGRATION, server.url, after]
            done = subprocess.run(command, check=False)
            assert done.returncode == -signal.SIGKILL, f"it was not killed: {done.returncode}"
            with server.connect() as connection:
                query = "SELECT count(*) FROM pg_tables WHERE schemaname = 'public'"
                found = connection.execute(query).fetchone()
            assert found == (0,), f"half a schema stayed: {found}"
        migrate(server.url)
        database = Database(server.url)
        assert is_current(database), "it cannot be migrated any more"
        database.dispose()
    finally:
        server.close()
    return "no table of it stayed, both times; the next migrate finished"


def restore_from_backup(run: Run) -> str:
    """Back up under a stream of uploads, restore elsewhere, and ask the checker of the copy."""
    folder = run.topology.folder
    run.clients.stream(12)
    time.sleep(1)
    told = run.history.so_far()
    assert run.clients.is_streaming(), "nobody submitted any more"
    head = write_backup(run.topology.database, run.topology.files, folder / "backup.tar")
    files = FileStore((folder / "restored").as_uri())
    url = f"sqlite:///{folder / 'restored.sqlite3'}"
    restore_backup(folder / "backup.tar", url, files)
    run.settle()
    for call in run.history.calls[len(told.calls) :]:  # the copy may know of them, or not
        told.note(dataclasses.replace(call, status=None, submission_id=None))
    restored = Database(url)
    found = check(restored, files, told, is_settled=False)
    with restored.read() as session:
        n_rows = session.scalar(select(func.count()).select_from(Submission))
    restored.dispose()
    assert found == [], found
    held = "the checker finds every promise of before kept"
    return f"{n_rows} submissions and {head.n_files} files of one moment; {held}"
