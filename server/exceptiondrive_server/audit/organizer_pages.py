"""The audit log: paged, filtered, and verified."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Annotated
from urllib.parse import urlencode

from fastapi import APIRouter, Query, Request
from fastapi.responses import Response

from exceptiondrive_records.accounts.tokens import names_of_actors
from exceptiondrive_records.audit.log import AuditVerdict, audit_page, verify_audit
from exceptiondrive_records.audit.tables import AuditLine
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.numbers import short_digest
from exceptiondrive_server.web.organizer_frame import OrganizerBrowser, organizer_page

# The audit log as a page shows it: who, what, about what, why, and the rest of the detail.


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


router = APIRouter(prefix="/organize/audit", include_in_schema=False)
SHOWN = 50
Filter = Annotated[str, Query(max_length=200)]


@router.get("")
def show_audit(
    request: Request,
    services: ServicesOf,
    browser: OrganizerBrowser,
    actor: Filter = "",
    subject: Filter = "",
    before: Annotated[int | None, Query(ge=1, lt=2**31)] = None,
    verify: bool = False,
) -> Response:
    """Show the log, newest first; with `verify` recompute the whole chain."""
    actor, subject = actor.strip(), subject.strip()
    with services.database.read() as session:
        lines = audit_page(
            session,
            before=before,
            limit=SHOWN + 1,
            actor=actor or None,
            subject=subject or None,
        )
        content = audit_view(
            lines,
            names_of_actors(session, (line.actor for line in lines)),
            actor=actor,
            subject=subject,
            shown=SHOWN,
            is_newest=before is None,
            verdict=verify_audit(session) if verify else None,
        )
    return organizer_page(request, browser, "audit/organizer_audit.html", "audit", page=content)
