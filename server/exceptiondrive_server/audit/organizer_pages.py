"""The audit log: paged, filtered, and verified; and the history of one subject, for other pages."""

import json
from dataclasses import dataclass
from typing import Annotated
from urllib.parse import urlencode

from fastapi import APIRouter, Query, Request
from fastapi.responses import Response
from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.tokens import names_of_actors
from exceptiondrive_records.audit.log import audit_page, verify_audit
from exceptiondrive_records.audit.tables import AuditLine
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.numbers import short_digest
from exceptiondrive_server.web.organizer_frame import OrganizerBrowser, organizer_page

router = APIRouter(prefix="/organize/audit", include_in_schema=False)
SHOWN = 50
Filter = Annotated[str, Query(max_length=200)]


@dataclass(frozen=True)
class HistoryLine:
    """A line of the log with its actor's name; its detail in words, the reason apart."""

    line: AuditLine
    actor_name: str
    reason: str
    detail: str


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
        lines = history(session, subject, actor=actor, before=before, limit=SHOWN + 1)
        verdict = verify_audit(session) if verify else None
    older = {"actor": actor, "subject": subject}
    if len(lines) > SHOWN:
        older["before"] = str(lines[SHOWN - 1].line.id)
    return organizer_page(
        request,
        browser,
        "audit/organizer_audit.html",
        "audit",
        lines=lines[:SHOWN],
        actor=actor,
        subject=subject,
        older="before" in older and urlencode({k: v for k, v in older.items() if v}),
        verdict=verdict,
        is_newest=before is None,
    )


def history(
    session: Session, subject: str, *, actor: str = "", before: int | None = None, limit: int
) -> list[HistoryLine]:
    """Return lines of the log for reading, newest first; empty subject or actor: any."""
    lines = audit_page(
        session, before=before, limit=limit, actor=actor or None, subject=subject or None
    )
    names = names_of_actors(session, (line.actor for line in lines))
    return [
        HistoryLine(
            line=line,
            actor_name=names.get(line.actor, line.actor),
            reason=str(line.detail.get("reason") or ""),
            detail=", ".join(f"{k} {_words(v)}" for k, v in line.detail.items() if k != "reason"),
        )
        for line in lines
    ]


def _words(value: object) -> str:
    text = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
    if text.startswith("sha256:"):
        return short_digest(text)
    return text if len(text) <= 80 else f"{text[:79]}…"
