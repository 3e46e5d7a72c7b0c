"""The audit log as a page shows it: who, what, about what, why, and the rest of the detail."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from urllib.parse import urlencode

from exceptiondrive_records.audit import AuditVerdict
from exceptiondrive_records.tables import AuditLine
from exceptiondrive_server.pages.numbers import short_digest


@dataclass(frozen=True)
class HistoryLine:
    """One line of the log."""

    number: int
    at: datetime
    actor: str
    actor_name: str
    action: str
    subject: str
    reason: str | None
    detail: str
    hash: str


@dataclass(frozen=True)
class AuditPage:
    """Everything that `audit.html` needs."""

    lines: tuple[HistoryLine, ...]
    actor: str
    subject: str
    older_url: str | None
    verdict: AuditVerdict | None
    is_newest: bool


def history_lines(lines: Sequence[AuditLine], names: Mapping[str, str]) -> tuple[HistoryLine, ...]:
    """Return lines of the log for reading; `names` tells who stands behind an actor."""
    return tuple(_line(line, names) for line in lines)


def audit_view(
    lines: Sequence[AuditLine],
    names: Mapping[str, str],
    *,
    actor: str,
    subject: str,
    shown: int,
    is_newest: bool,
    verdict: AuditVerdict | None = None,
) -> AuditPage:
    """Set the page; one line more than `shown` means that there are older ones."""
    has_older = len(lines) > shown
    query = (
        {"actor": actor, "subject": subject, "before": str(lines[shown - 1].id)}
        if has_older
        else {}
    )
    kept = {name: value for name, value in query.items() if value}
    return AuditPage(
        lines=history_lines(lines[:shown], names),
        actor=actor,
        subject=subject,
        older_url=f"/organize/audit?{urlencode(kept)}" if has_older else None,
        verdict=verdict,
        is_newest=is_newest,
    )


def _line(line: AuditLine, names: Mapping[str, str]) -> HistoryLine:
    detail = dict(line.detail)
    reason = detail.pop("reason", None)
    return HistoryLine(
        number=line.id,
        at=line.at,
        actor=line.actor,
        actor_name=names.get(line.actor, line.actor),
        action=line.action,
        subject=line.subject,
        reason=None if reason is None else str(reason),
        detail=", ".join(f"{key} {_words(value)}" for key, value in detail.items()),
        hash=line.hash,
    )


def _words(value: object) -> str:
    text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
    if text.startswith("sha256:"):
        return short_digest(text)
    return text if len(text) <= 80 else f"{text[:79]}…"
