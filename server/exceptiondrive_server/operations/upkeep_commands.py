"""Operator commands for maintenance: backup, restore, verify, doctor."""

import os
from datetime import timedelta
from pathlib import Path
from typing import Annotated

import typer

from exceptiondrive_records.audit.log import audit, verify_audit
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.db.errors import RecordsError
from exceptiondrive_records.db.settings import RecordsSettings, load_settings
from exceptiondrive_records.operations.dump import (
    BACKUP,
    BACKUP_FAILED,
    BACKUP_WRITTEN,
    begin_snapshot,
)
from exceptiondrive_records.operations.garbage import GRACE, sweep_orphans
from exceptiondrive_records.operations.invariants import damaged_uploads, violations
from exceptiondrive_records.operations.setup import opened
from exceptiondrive_records.submissions.file_store import FileStore
from exceptiondrive_schemas.printable import counted
from exceptiondrive_server.launcher.broker import broker_url
from exceptiondrive_server.launcher.layout import Layout
from exceptiondrive_server.operations.backup import (
    LIMIT_BYTES,
    BackupHead,
    restore_backup,
    write_backup,
)
from exceptiondrive_server.operations.records_commands import ACTOR, DataOption, say
from exceptiondrive_server.web.settings import ServerSettings

upkeep_app = typer.Typer()
File = Annotated[Path, typer.Argument(metavar="FILE", dir_okay=False, help="The backup, one file.")]


@upkeep_app.command("backup")
def backup(
    file: File,
    without_lost: Annotated[
        bool,
        typer.Option("--without-lost", help="Leave out uploads that are missing or damaged."),
    ] = False,
    data: DataOption = None,
) -> None:
    """Write all records and uploads of one moment into FILE; the server may run meanwhile."""
    settings = load_settings(RecordsSettings, data)
    files = FileStore(settings.file_store_url)
    with opened(settings) as database:
        try:
            head = write_backup(database, files, file, without_lost=without_lost)
        except RecordsError:
            _audit_backup(database, BACKUP_FAILED)
            raise
        say(f"{head.n_files} files and {head.audit_lines} audit lines in {file}; keep it private")
        _tell_lost(head)
        _audit_backup(database, BACKUP_WRITTEN, as_of=head.created_at)
        with database.read() as session:
            begin_snapshot(session)
            broken = violations(session)
        for violation in broken[:20]:
            say(f"restore would refuse it: {violation}")


def _tell_lost(head: BackupHead) -> None:
    for digest in head.without:
        say(f"without {digest}, which was lost when it was written")


def _audit_backup(database: Database, action: str, **detail: str) -> None:
    if database.takes_writes():  # a standby does not
        with database.write() as session:
            audit(session, ACTOR, action, BACKUP, detail)


@upkeep_app.command("restore")
def restore(file: File, data: DataOption = None) -> None:
    """Restore FILE into empty records, of any database, and check everything."""
    if data is not None:
        Layout(data).create()
    settings = load_settings(RecordsSettings, data)
    head = restore_backup(file, settings.database_url, FileStore(settings.file_store_url))
    say(f"restored as of {head.created_at}: {head.n_files} files, audit chain intact")
    _tell_lost(head)
    if settings.database_url.startswith("postgresql"):
        say("next: exceptiondrive-server migrate --grant-to, which gives each service its rights")
    say(
        "next: put back the key that signs receipts, which no backup holds; without it, a new one "
        "signs from then on, and former receipts stay valid"
    )
    say("next: register the splits again with exceptiondrive-worker, then start everything")


@upkeep_app.command("verify")
def verify(
    uploads: Annotated[
        bool, typer.Option("--uploads/--no-uploads", help="Read every upload too.")
    ] = True,
    data: DataOption = None,
) -> None:
    """Check every invariant of records and uploads; exit code 2 when one is broken."""
    settings = load_settings(RecordsSettings, data)
    with opened(settings) as database, database.read() as session:
        begin_snapshot(session)
        found = violations(session)
        if uploads:
            files = FileStore(settings.file_store_url)
            found += damaged_uploads(session, files, limit_bytes=LIMIT_BYTES)
        verdict = verify_audit(session)
    for violation in found:
        typer.echo(str(violation))
    if found:
        raise RecordsError(
            f"{counted(len(found), 'broken invariant')}; see `broken invariants` in docs/operating.md"
        )
    say(f"every invariant holds; {verdict.n_lines} audit lines, head {verdict.head}")


@upkeep_app.command("sweep")
def sweep(
    older_than_hours: Annotated[
        float, typer.Option(min=1, help="Younger files may belong to an upload under way.")
    ] = GRACE.total_seconds() / 3600,
    data: DataOption = None,
) -> None:
    """Remove stored files that no record mentions, as crashes leave them. The server may run."""
    settings = load_settings(RecordsSettings, data)
    grace = timedelta(hours=older_than_hours)
    with opened(settings) as database:
        files = FileStore(settings.file_store_url)
        swept = sweep_orphans(database, files, actor=ACTOR, grace=grace)
    say(f"{swept.n_files} orphaned files removed, {swept.n_bytes} bytes")


@upkeep_app.command("doctor")
def doctor(
    withheld: Annotated[
        list[Path] | None,
        typer.Option(
            "--withheld",
            readable=False,  # it is as it should be where it cannot be read
            help="A folder that this user must not enter; repeatable.",
        ),
    ] = None,
    data: DataOption = None,
) -> None:
    """Examine settings, permissions, walls, broker, database and clocks; exit code 1 on errors."""
    from exceptiondrive_server.operations.doctor import Severity, examine

    settings = load_settings(ServerSettings, data)
    if data is not None and "EXCEPTIONDRIVE_BROKER_URL" not in os.environ:
        private = broker_url(data.resolve() / "broker")
        settings = settings.model_copy(update={"broker_url": private})
    findings = examine(settings, tuple(withheld or ()), data)
    for finding in findings:
        typer.echo(f"{finding.severity:8}{finding.what}")
        if finding.do:
            typer.echo(f"{'':8}  -> {finding.do}")
    if any(finding.severity is Severity.ERROR for finding in findings):
        raise typer.Exit(1)
