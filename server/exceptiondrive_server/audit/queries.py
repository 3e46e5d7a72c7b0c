"""The audit log as pages read it: lines with names and words, of one subject or of all."""

import json
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from pydantic import BaseModel
from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.tokens import names_of_actors
from exceptiondrive_records.audit.log import audit_page
from exceptiondrive_records.audit.tables import AuditLine
from exceptiondrive_server.web.numbers import short_digest


class AuditLineView(BaseModel):
    """One line of the audit log."""

    id: int
    at: datetime
    actor: str
    action: str
    subject: str
    detail: dict[str, Any]
    hash: str


def line_view(line: AuditLine) -> AuditLineView:
    """Return a line as the API shows it."""
    return AuditLineView(
        id=line.id,
        at=line.at,
        actor=line.actor,
        action=line.action,
        subject=line.subject,
        detail=line.detail,
        hash=line.hash,
    )


@dataclass(frozen=True)
class HistoryLine:
    """A line of the log with its actor's name; its detail in words, the reason apart."""

    line: AuditLine
    actor_name: str
    reason: str
    detail: str


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
