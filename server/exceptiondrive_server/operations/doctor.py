"""The doctor: checks settings, permissions, isolation, broker, database and clocks.

Every finding says what to do. Read-only.
"""

import os
import platform
import sqlite3
import stat
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from enum import StrEnum
from functools import partial
from pathlib import Path
from urllib.parse import unquote, urlsplit

import redis
from kombu.utils.url import parse_url
from redis.backoff import NoBackoff
from redis.retry import Retry
from sqlalchemy import make_url, select, text
from sqlalchemy.exc import DBAPIError, SQLAlchemyError

from exceptiondrive_records.boards.tables import BoardEntryRow
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.database import Database, sentence_of
from exceptiondrive_records.db.errors import StoreError
from exceptiondrive_records.db.settings import RecordsSettings
from exceptiondrive_records.migrations import (
    MADE_EARLIER_CURE,
    is_current,
    is_usable,
    missing_schema,
)
from exceptiondrive_records.operations.overview import lane_queue
from exceptiondrive_records.operations.troubles import troubles
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.submissions.file_store import (
    LEAST_FREE_BYTES,
    LOW_ON_ROOM_BYTES,
    FileStore,
    seems_unmounted,
)
from exceptiondrive_records.submissions.tables import ScoreSheetRow
from exceptiondrive_records.teams.teams import names_that_look_alike
from exceptiondrive_records.work.heartbeats import scorers_at_work
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_schemas.printable import printable
from exceptiondrive_server.submissions.receipts import read_or_make_key
from exceptiondrive_server.web.settings import ServerSettings

_CLOCK_SKEW_S = 2.0
_OLDEST_QUEUED_S = 60.0
_NO_FILE = "sha256:" + "0" * 64
_LOOK = os.R_OK | os.X_OK
_OTHERS = stat.S_IRWXG | stat.S_IRWXO
_IMMUTABLE = (
    "audit_lines",
    "board_entries",
    "board_flips",
    "boards",
    "protocols",
    "score_sheets",
    "split_openings",
    "submission_edits",
)
GUARDS = {
    "sqlite": {f"{table}_no_{act}" for table in _IMMUTABLE for act in ("update", "delete")}
    - {"protocols_no_delete"},
    "postgresql": {f"{table}_append_only" for table in _IMMUTABLE}
    | {"boards_go_with_phase", "board_flips_go_with_phase"},
}
"""Triggers that keep tables append-only, by the kind of database."""


class Severity(StrEnum):
    """How bad a finding is. Errors make the exit code 1."""

    OK = "ok"
    WARNING = "warning"
    ERROR = "error"


@dataclass(frozen=True)
class Finding:
    """What was found, and what to do about it; nothing when all is well."""

    severity: Severity
    what: str
    do: str = ""


_ok = partial(Finding, Severity.OK)
_warning = partial(Finding, Severity.WARNING)
_error = partial(Finding, Severity.ERROR)


def examine(
    settings: ServerSettings, withheld: tuple[Path, ...] = (), data: Path | None = None
) -> list[Finding]:
    """Return all findings.

    `withheld` are folders that the user of the server must not be able to enter; `data` is that of an
    `exceptiondrive-server run`, which starts every process of it.
    """
    return [
        *_check_versions(),
        _ok("the settings are valid and fit each other"),  # else there were none
        *_check_database(settings, data),
        *_check_broker(settings.broker_url),
        *_check_store(settings.file_store_url),
        *_receipt_key(settings.receipt_key_file),
        *(finding for folder in withheld for finding in _check_wall(folder)),
    ]


def _check_versions() -> Iterator[Finding]:
    said = f"Python {platform.python_version()}, SQLite {sqlite3.sqlite_version}"
    if sqlite3.sqlite_version_info < (3, 35):
        yield _error(said, "install SQLite 3.35 or later (RETURNING)")
    else:
        yield _ok(said)


def _check_database(settings: RecordsSettings, data: Path | None) -> Iterator[Finding]:
    url = make_url(settings.database_url)
    if url.get_backend_name() == "sqlite":
        path = Path(url.database or "")
        if not path.is_file():
            yield _error(f"no records at {path}", "run: exceptiondrive-server migrate")
            return
        yield from _private_file(path, "the records")
    database = Database(settings.database_url)
    try:
        if not is_usable(database):
            yield _error(
                "the records have an older schema than this version",
                "back up, then run: exceptiondrive-server migrate",
            )
            return
        if lacks := missing_schema(database):
            yield _error(lacks, f"{MADE_EARLIER_CURE}; waiting does not help")
            return
        schema = "current" if is_current(database) else "newer than this version, which is fine"
        yield _ok(f"the records answer ({url.get_backend_name()}), schema {schema}")
        if not database.takes_writes():
            yield _error(
                "the records can be read but not written: uploads are refused",
                "name the primary database, not a standby; or give the file and its folder to the "
                "server's user, with the right to write",
            )
        yield from _check_clock(database)
        yield from _check_queue(database, data)
        yield from _check_boards(database)
        yield from _append_only(database)
        yield from _check_names(database)
        yield from _check_mount(database, settings.file_store_url)
    except SQLAlchemyError as error:
        yield _error(
            _words_of(error),
            "check EXCEPTIONDRIVE_DATABASE_URL, the network and the database's own log",
        )
    finally:
        database.dispose()


def _words_of(error: SQLAlchemyError) -> str:
    if isinstance(error, DBAPIError):
        with suppress(DBAPIError):
            return sentence_of(error)
    return f"the database reports an error ({type(error).__name__})"


def _check_clock(database: Database) -> Iterator[Finding]:
    with database.read() as session:
        skew_s = (database_now(session) - datetime.now(UTC)).total_seconds()
    if abs(skew_s) > _CLOCK_SKEW_S:
        yield _warning(
            f"this machine's clock is {-skew_s:+.1f} s from the database's",
            "leases are safe, they follow the database; set up NTP for logs and TLS",
        )
    else:
        yield _ok("the clocks of this machine and of the database agree")


def _check_queue(database: Database, data: Path | None) -> Iterator[Finding]:
    with database.read() as session:
        oldest_s = lane_queue(session, Lane.LIVE).oldest_s
        found = troubles(session)
        scorers = scorers_at_work(session)
        has_phases = session.scalar(select(Phase.id).limit(1)) is not None
    start = f"start its server: exceptiondrive-server run --data {data}, or make run DATA={data}"
    for trouble in found:
        is_of_run = data is not None and trouble.code in ("lane_without_worker", "no_reconciler")
        yield _warning(trouble.what, start if is_of_run else trouble.do)
    if len(scorers) > 1:
        older = ", ".join(scorers[:-1])
        yield _warning(
            f"workers run scorer {older} beside {scorers[-1]}: the older ones score nothing",
            "upgrade them; see `upgrade` in docs/operating.md",
        )
    if oldest_s is not None and oldest_s > _OLDEST_QUEUED_S:
        yield _warning(
            f"the oldest submission in the lane {Lane.LIVE} has waited for {oldest_s:.0f} s",
            "see `stuck queue` in docs/operating.md",
        )
    if not has_phases:
        yield _warning("there is no phase", "make one: exceptiondrive organizer phases create")


def _check_boards(database: Database) -> Iterator[Finding]:
    """All sheets of a board should be of one scorer; an upgrade to a newer one leaves those that are there."""
    query = (
        select(Phase.id, ScoreSheetRow.scorer_version)
        .join(BoardEntryRow, BoardEntryRow.board_id == Phase.current_board_id)
        .join(
            ScoreSheetRow,
            (ScoreSheetRow.submission_id == BoardEntryRow.submission_id)
            & (ScoreSheetRow.protocol_digest == Phase.protocol_digest)
            & (ScoreSheetRow.split_revision == Phase.split_revision),
        )
        .distinct()
    )
    found: dict[str, list[str]] = {}
    with database.read() as session:
        for phase_id, scorer in session.execute(query.order_by(Phase.id)):
            found.setdefault(phase_id, []).append(scorer)
    for phase_id, scorers in found.items():
        if len(scorers) > 1:
            yield _warning(
                f"the board of phase {phase_id} has sheets of scorers {', '.join(sorted(scorers))}",
                "add the protocol again under its next version, and rescore to it: "
                "`a new scorer` in docs/rescoring.md",
            )


def _append_only(database: Database) -> Iterator[Finding]:
    """What is never overwritten must refuse to be changed."""
    dialect = database.engine.dialect.name
    listing = {
        "sqlite": "SELECT name FROM sqlite_master WHERE type = 'trigger'",
        "postgresql": "SELECT tgname FROM pg_trigger "
        "WHERE NOT tgisinternal AND tgenabled IN ('O', 'A')",  # that is, at work in every session
    }[dialect]
    with database.read() as session:
        missing = GUARDS[dialect] - set(session.scalars(text(listing)))
    if missing:
        yield _error(
            "triggers that keep tables append-only are gone or disabled: "
            f"{', '.join(sorted(missing))}",
            "restore a backup into new records: somebody has altered the schema",
        )


def _check_names(database: Database) -> Iterator[Finding]:
    with database.read() as session:
        found = names_that_look_alike(session)
    for names in found:
        yield _warning(
            f"teams have names that look alike: {printable(', '.join(names))}",
            "they stay as they are; ask one of them for another name (page Teams)",
        )


def _check_broker(url: str) -> Iterator[Finding]:
    client = _client(url)
    try:
        policy = _of_config(client, "maxmemory-policy")
        limit = _of_config(client, "maxmemory")
    except redis.AuthenticationError:
        yield _warning(
            "the broker expects another password than EXCEPTIONDRIVE_BROKER_URL gives: scoring waits, "
            "nothing is lost",
            "write the broker's password there; see `rotate keys` in docs/operating.md",
        )
        return
    except redis.RedisError as error:
        yield _warning(
            f"the broker does not answer ({type(error).__name__}): scoring waits, nothing is lost",
            "start the server, if the broker is its own; else check EXCEPTIONDRIVE_BROKER_URL and "
            "the broker's log",
        )
        return
    finally:
        client.close()
    if policy not in (None, "noeviction"):
        yield _warning(
            f"the broker's maxmemory-policy is {policy}: it may discard messages",
            "set maxmemory-policy noeviction; until then scoring is only slower",
        )
    elif limit == "0":
        yield _warning("the broker may take all memory", "set maxmemory 256mb")
    elif policy is None or limit is None:
        yield _ok("the broker answers, but does not say whether it evicts anything")
    else:
        yield _ok("the broker answers and evicts nothing")


_ONCE = Retry(NoBackoff(), 0)
"""On a Unix socket redis-py would try a broker that is away for five seconds; over TCP it does not."""


def _client(url: str) -> redis.Redis:
    if url.startswith("redis+socket://"):
        path = "/" + str(parse_url(url)["virtual_host"]).lstrip("/")
        return redis.Redis(unix_socket_path=path, socket_timeout=2, retry=_ONCE)
    return redis.Redis.from_url(url, socket_timeout=2, socket_connect_timeout=2)


def _of_config(client: redis.Redis, name: str) -> str | None:
    """Return a value of the broker's configuration; None if the broker refuses."""
    try:
        found = client.config_get(name)
    except redis.exceptions.ResponseError:
        return None
    assert isinstance(found, dict)
    return found.get(name)


def _check_store(url: str) -> Iterator[Finding]:
    folder = Path(unquote(urlsplit(url).path))
    if url.startswith("file:") and not os.path.isdir(folder):  # False where it is closed
        yield _error(
            f"there is no folder {folder} that this user may see",
            "check EXCEPTIONDRIVE_FILE_STORE_URL; the server makes the folder when it starts",
        )
        return
    if url.startswith("file:") and not os.access(folder, _LOOK):
        yield _error(
            f"this user may not enter {folder}, which is of user {folder.stat().st_uid}",
            "give the folder and all in it to the server's user",
        )
        return
    try:
        FileStore(url).holds(_NO_FILE)
    except (StoreError, OSError) as error:
        yield _error(
            f"the file store does not answer ({type(error.__cause__ or error).__name__})",
            "check EXCEPTIONDRIVE_FILE_STORE_URL, its bucket and credentials, and the clock",
        )
        return
    if not url.startswith("file:"):
        yield _ok("the file store answers")
        return
    if not os.access(folder, os.W_OK):
        yield _error(
            f"{folder} cannot be written",
            "mount it for writing, or give the server's user write access",
        )
    free_bytes = FileStore(url).free_bytes() or 0
    if free_bytes < LEAST_FREE_BYTES:
        yield _error(
            f"less than 64 MiB is free under {folder}: uploads are refused",
            "make room, see `disk full` in docs/operating.md; no restart is needed",
        )
    elif free_bytes < LOW_ON_ROOM_BYTES:
        yield _warning(
            f"less than 1 GiB is free under {folder}; below 64 MiB uploads are refused",
            "make room, see `disk full` in docs/operating.md",
        )
    if stat.S_IMODE(folder.stat().st_mode) & stat.S_IRWXO:
        yield _error(f"every user may enter {folder}", f"run: chmod o-rwx {folder}")
    else:
        yield _ok("the file store answers and is closed to others")


def _check_mount(database: Database, url: str) -> Iterator[Finding]:
    folder = Path(unquote(urlsplit(url).path))
    if not url.startswith("file:") or not os.path.isdir(folder) or not os.access(folder, _LOOK):
        return  # nothing is made by looking; `_check_store` says what is wrong
    with database.read() as session:
        is_away = seems_unmounted(session, FileStore(url))
    if is_away:
        yield _error(
            f"{folder} is empty, but the records mention uploads: new ones are refused",
            "mount what belongs there, or restore the uploads from a backup",
        )


def _receipt_key(path: Path) -> Iterator[Finding]:
    """Check the receipt key; a missing one is created with the first receipt, if its folder allows."""
    if not os.path.exists(path):  # False where its folder is closed
        folder = next(parent for parent in path.absolute().parents if os.path.isdir(parent))
        if not os.access(folder, os.W_OK | os.X_OK):
            yield _error(
                f"receipts cannot be signed: there is no key {path}, and this user cannot create one there",
                "put the key back; see `rotate keys` in docs/operating.md",
            )
        return
    try:
        read_or_make_key(path)
    except StoreError as error:
        yield _error(
            f"{printable(str(error))} ({path})",
            "make that file an Ed25519 key in PEM which the server's user may read; see `rotate keys` "
            "in docs/operating.md",
        )


def _private_file(path: Path, name: str) -> Iterator[Finding]:
    is_open = path.parent.stat().st_mode & stat.S_IXOTH
    if path.stat().st_mode & stat.S_IRWXO and is_open:
        yield _warning(
            f"every user may read {name} at {path}: digests of tokens, names, reports",
            f"run: chmod o-rwx {path.parent}",
        )


def _check_wall(folder: Path) -> Iterator[Finding]:
    """The user of the server must not get into what is withheld."""
    try:
        found = folder.stat()
    except PermissionError:  # a folder above it is closed already
        yield _ok(f"this user cannot enter {folder}")
        return
    except OSError:
        yield _error(
            f"there is no {folder}: nothing was examined",
            "name the folder of splits or of the private store that the workers use",
        )
        return
    if os.geteuid() == 0:
        yield _warning(
            f"cannot tell whether the server may enter {folder}: this is root",
            "run the doctor as the server's user",
        )
        return
    if os.access(folder, os.R_OK) or os.access(folder, os.X_OK):
        if found.st_uid == os.geteuid() and not stat.S_IMODE(found.st_mode) & _OTHERS:
            do = "run server and workers as different users"
        else:
            do = f"run: chmod 0700 {folder}, owned by the workers' user"
        yield _error(f"this user may read {folder}, which is withheld", do)
    else:
        yield _ok(f"this user cannot enter {folder}")
