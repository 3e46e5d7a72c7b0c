"""Faults of records alone: many writers, an interrupted migration, a restore."""

import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from sqlalchemy import func, select
from tests.chaos.run import Run

from exceptiondrive_records.audit import count_audit_lines, verify_audit
from exceptiondrive_records.database import Database
from exceptiondrive_records.file_store import FileStore
from exceptiondrive_records.invariants import damaged_uploads, violations
from exceptiondrive_records.migrations import is_current, migrate
from exceptiondrive_records.tables import Submission
from exceptiondrive_server.backup import restore_backup, write_backup

_WRITER = """
import sys
from exceptiondrive_records.audit import audit
from exceptiondrive_records.database import Database
database = Database(sys.argv[1])
for number in range(60):
    with database.write() as session:
        audit(session, f"writer:{sys.argv[2]}", "wrote", str(number))
"""
_MIGRATION = """
import os, signal, sys
from sqlalchemy import event
from exceptiondrive_records import database
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
    began = time.monotonic()
    writers = [
        subprocess.Popen([sys.executable, "-c", _WRITER, url, str(number)], stderr=subprocess.PIPE)
        for number in range(6)
    ]
    errors = [writer.communicate()[1] for writer in writers]
    took_s = time.monotonic() - began
    database = Database(url)
    with database.read() as session:
        n_lines, verdict = count_audit_lines(session, "wrote"), verify_audit(session)
    database.dispose()
    shutil.rmtree(folder)
    assert not any(errors), errors
    assert n_lines == 360, f"{n_lines} of 360 lines"
    assert verdict.is_whole, "the chain is broken"
    return f"360 of 360 transactions in {took_s:.1f} s, 0 locked, chain whole"


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


def restore_from_backup(run: Run) -> str:
    """Back up under a stream of uploads, restore elsewhere, and ask the checker of the copy."""
    folder = run.topology.folder
    run.clients.stream(8)
    time.sleep(1)
    head = write_backup(run.topology.database, run.topology.files, folder / "backup.tar")
    files = FileStore((folder / "restored").as_uri())
    url = f"sqlite:///{folder / 'restored.sqlite3'}"
    restore_backup(folder / "backup.tar", url, files)
    restored = Database(url)
    with restored.read() as session:
        found = violations(session)
        found += damaged_uploads(session, files, limit_bytes=2**24)
        n_rows = session.scalar(select(func.count()).select_from(Submission))
    restored.dispose()
    run.settle()
    assert found == [], found
    return f"{n_rows} submissions and {head.n_files} files of one moment, every invariant holds"
