"""The audit chain: each line carries the hash of the previous line.

A write transaction collects its lines and chains them just before it commits. So the head of the
chain is locked last, briefly, and never in a cycle with other locks. PostgreSQL computes the hashes
itself, which saves a round trip while the head is locked.
"""

import hashlib
import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import TYPE_CHECKING, Any

from sqlalchemy import Select, func, insert, select
from sqlalchemy.orm import Session

from exceptiondrive_records.audit.tables import AuditLine
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_schemas.base import canonical_json

if TYPE_CHECKING:
    import psycopg

GENESIS = "0" * 64
_PENDING = "exceptiondrive_pending_audit"
PROBING_SUSPECTED = "probing suspected"
"""Action: workers found submissions that change few samples at a time; the subject is the phase."""
SPLIT_FLOOR_HELD = "split floor held"
"""Action: a floor made a worker refuse work on a withheld split; the subject is the split."""
_CHAIN_LOCK = 0x45446175  # any constant: the advisory lock of the chain on PostgreSQL


_SAID = ("id", "at", "actor", "action", "subject", "detail")
_NEW_LINES = insert(AuditLine)
_HEAD = select(AuditLine.id, AuditLine.hash).order_by(AuditLine.id.desc()).limit(1)
_DIGITS = """to_char(at AT TIME ZONE 'UTC', 'YYYY-MM-DD"T"HH24:MI:SS.US')"""
ISO_AT = f"replace({_DIGITS}, '.000000', '') || '+00:00'"
"""SQL for PostgreSQL that writes a column `at` as `datetime.isoformat` does."""
_CHAIN_IN_SQL = f"""
WITH line AS (
    SELECT statement_timestamp() AS at, coalesce(head.id, 0) + 1 AS id, coalesce(head.hash, '{GENESIS}') AS previous
    FROM (SELECT 1) AS one LEFT JOIN (SELECT id, hash FROM audit_lines ORDER BY id DESC LIMIT 1) AS head ON true
), told AS (
    SELECT *, {ISO_AT} AS iso FROM line
)
INSERT INTO audit_lines (id, at, actor, action, subject, detail, previous_hash, hash)
SELECT id, at, %(actor)s, %(action)s, %(subject)s, %(detail)s::json, previous,
    encode(sha256(convert_to(
        previous || %(before_at)s || iso || %(before_id)s || id || %(before_end)s, 'UTF8'
    )), 'hex')
FROM told
"""
"""Computes the same hash as `line_hash`: canonical JSON sorts its keys alphabetically."""


@dataclass(frozen=True)
class _Pending:
    actor: str
    action: str
    subject: str
    detail: dict[str, Any]


def audit(
    session: Session, actor: str, action: str, subject: str, detail: Mapping[str, Any] | None = None
) -> None:
    """Record that `actor` did `action` to `subject` in this write transaction."""
    lines = session.info.setdefault(_PENDING, [])
    lines.append(_Pending(actor, action, subject, dict(detail or {})))


def audit_once(
    session: Session, actor: str, action: str, subject: str, detail: Mapping[str, Any]
) -> None:
    """Record an action unless the log has the same line already."""
    query = select(AuditLine.detail).where(AuditLine.action == action, AuditLine.subject == subject)
    pending: list[_Pending] = session.info.get(_PENDING, [])
    said = [line.detail for line in pending if (line.action, line.subject) == (action, subject)]
    if dict(detail) not in [*session.scalars(query), *said]:
        audit(session, actor, action, subject, detail)


def last_action(session: Session, subject: str, *actions: str) -> str | None:
    """Return the latest of these actions on the subject, among chained lines."""
    query = select(AuditLine.action).where(
        AuditLine.subject == subject, AuditLine.action.in_(actions)
    )
    return session.scalar(query.order_by(AuditLine.id.desc()).limit(1))


def lines_of_a_day(session: Session, actions: Collection[str], subjects: Select[str]) -> int:
    """Count the lines of the last 24 hours with one of these actions on any of the subjects."""
    since = database_now(session) - timedelta(days=1)
    query = select(func.count()).select_from(AuditLine).where(AuditLine.at > since)
    query = query.where(AuditLine.subject.in_(subjects), AuditLine.action.in_(actions))
    return session.scalar(query) or 0


def take_audit_lines(session: Session) -> list[_Pending]:
    """Return the lines of this transaction, which `Database.write` chains before it commits."""
    lines: list[_Pending] = session.info.pop(_PENDING, [])
    return lines


def chain_in_sql(driver: "psycopg.Connection[Any]", lines: Sequence[_Pending]) -> None:
    """Chain lines on PostgreSQL under the lock of the chain, without waiting for results."""
    told = [_in_sql(line) for line in lines]
    if told:
        driver.execute(f"SELECT pg_advisory_xact_lock({_CHAIN_LOCK})")
    for line in told:
        driver.execute(_CHAIN_IN_SQL, line)


def _in_sql(line: _Pending) -> dict[str, str]:
    actor, action, subject, detail = (
        canonical_json(value).decode()
        for value in (line.actor, line.action, line.subject, line.detail)
    )
    return {
        "actor": line.actor,
        "action": line.action,
        "subject": line.subject,
        "detail": json.dumps(line.detail),
        "before_at": f'{{"action":{action},"actor":{actor},"at":"',
        "before_id": f'","detail":{detail},"id":',
        "before_end": f',"subject":{subject}}}',
    }


def chain_audit_lines(session: Session, lines: Sequence[_Pending]) -> None:
    """Chain lines on SQLite, which needs no lock: it has one writer at a time."""
    if not lines:
        return
    last, head = session.execute(_HEAD).first() or (0, GENESIS)
    at, rows = database_now(session), []
    for number, line in enumerate(lines, last + 1):
        told = {"id": number, "at": at, **vars(line), "previous_hash": head}
        head = _hash_of(told)
        rows.append(told | {"hash": head})
    session.connection().execute(_NEW_LINES, rows)


def line_hash(line: AuditLine) -> str:
    """Return the SHA-256 of the previous hash and the whole content of the line."""
    return _hash_of({name: getattr(line, name) for name in (*_SAID, "previous_hash")})


def _hash_of(told: Mapping[str, Any]) -> str:
    content = {name: told[name] for name in _SAID} | {"at": told["at"].isoformat()}
    return hashlib.sha256(told["previous_hash"].encode() + canonical_json(content)).hexdigest()


@dataclass(frozen=True)
class AuditVerdict:
    """Whether the chain is intact; if not, the first line that breaks it."""

    n_lines: int
    head: str
    broken_at: int | None = None
    holds_kept_head: bool | None = None
    """Whether a line has the given hash of an earlier head; None if none was given."""

    @property
    def is_whole(self) -> bool:
        """Whether every line follows from the one before it."""
        return self.broken_at is None


def verify_audit(session: Session, kept_head: str | None = None) -> AuditVerdict:
    """Recompute the whole chain.

    `kept_head` is the head hash of an earlier verification. A log that was truncated or rewritten
    from some line on is a valid chain as well, but no line of it has this hash.
    """
    head = GENESIS
    number = 0
    holds_kept = None if kept_head is None else kept_head == GENESIS
    query = select(AuditLine).order_by(AuditLine.id).execution_options(yield_per=500)
    with session.scalars(query) as lines:
        for line in lines:
            if not _follows(line, number, head) or line_hash(line) != line.hash:
                return AuditVerdict(number, head, line.id, holds_kept)
            number, head = line.id, line.hash
            holds_kept = holds_kept or (None if kept_head is None else head == kept_head)
    return AuditVerdict(number, head, None, holds_kept)


def _follows(line: AuditLine, number: int, head: str) -> bool:
    """Whether a line directly follows the one with this number and hash."""
    return line.id == number + 1 and line.previous_hash == head


def audit_page(
    session: Session,
    *,
    before: int | None = None,
    limit: int = 100,
    actor: str | None = None,
    subject: str | None = None,
    since: datetime | None = None,
    action: str | None = None,
) -> list[AuditLine]:
    """Return lines, newest first.

    Arguments filter them; an `action` is, for example, `phase changed`.
    """
    query = select(AuditLine).order_by(AuditLine.id.desc()).limit(limit)
    if before is not None:
        query = query.where(AuditLine.id < before)
    if since is not None:
        query = query.where(AuditLine.at >= since)
    for name, value in {"actor": actor, "subject": subject, "action": action}.items():
        if value is not None:
            query = query.where(getattr(AuditLine, name) == value)
    return list(session.scalars(query))


def audit_actions(session: Session) -> list[str]:
    """Return all actions in the log, sorted."""
    return sorted(session.scalars(select(AuditLine.action).distinct()))
