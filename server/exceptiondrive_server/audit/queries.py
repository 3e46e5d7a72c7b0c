"""Read the audit log for pages: its lines in words, for one subject or for all."""

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from pydantic import BaseModel
from sqlalchemy import select
from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.tokens import names_of_actors
from exceptiondrive_records.audit.log import audit_page
from exceptiondrive_records.audit.tables import AuditLine
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_server.web.numbers import short_digest

_BEFORE_AND_AFTER = ("phase changed", "team changed", "site links changed")
"""Kinds of lines that hold of each thing how it was and how it is."""


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
    return AuditLineView.model_validate(line, from_attributes=True)


@dataclass(frozen=True)
class HistoryLine:
    """A line of the log with its actor's name; its detail in words, the reason apart."""

    line: AuditLine
    actor_name: str
    subject_name: str
    """Of a submission its method, of a phase its title; else the subject itself."""
    page: str
    """Of the subject; empty: it has none."""
    reason: str
    detail: str


def history(
    session: Session,
    subject: str,
    *,
    limit: int,
    actor: str = "",
    action: str = "",
    **narrowed: Any,
) -> list[HistoryLine]:
    """Return lines of the log for reading, newest first, narrowed as `audit_page` does it.

    An empty subject, actor or action is any.
    """
    narrowed |= {"subject": subject or None, "actor": actor or None, "action": action or None}
    lines = audit_page(session, limit=limit, **narrowed)
    phases = {line.detail["phase"] for line in lines if isinstance(line.detail.get("phase"), str)}
    subjects = _subjects(session, {line.subject for line in lines} | phases)
    names = names_of_actors(session, (line.actor for line in lines))
    return [
        HistoryLine(
            line=line,
            actor_name=names.get(line.actor, line.actor),
            subject_name=subjects.get(line.subject, (line.subject, ""))[0],
            page=subjects.get(line.subject, (line.subject, ""))[1],
            reason=str(line.detail.get("reason") or ""),
            detail="; ".join(_detail_lines(line, subjects)),
        )
        for line in lines
    ]


def _subjects(session: Session, ids: set[str]) -> dict[str, tuple[str, str]]:
    """Name and page of the submissions and phases among some subjects."""
    methods = select(Submission.id, Submission.method).where(Submission.id.in_(ids))
    titles = select(Phase.id, Phase.title).where(Phase.id.in_(ids))
    found = {key: (name, f"/organize/submissions/{key}") for key, name in session.execute(methods)}
    return found | {key: (name, f"/organize/phases/{key}") for key, name in session.execute(titles)}


def _detail_lines(line: AuditLine, subjects: dict[str, tuple[str, str]]) -> Iterator[str]:
    """Yield what a line holds besides its reason, phases by their titles."""
    for key, value in line.detail.items():
        if key == "reason":
            continue
        if key == "phase" and value in subjects:
            words = f"{subjects[value][0]} ({value})"
        elif line.action in _BEFORE_AND_AFTER and isinstance(value, list):
            words = " → ".join(_value_words(one) for one in value)
        else:
            words = _value_words(value)
        yield f"{key.replace('_', ' ')}: {words}"


def _value_words(value: object) -> str:
    if value is None or value == "" or value == [] or value == {}:
        return "nothing"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list):
        text = ", ".join(map(_value_words, value))
    elif isinstance(value, dict):
        text = ", ".join(
            f"{str(key).replace('_', ' ')} {_value_words(one)}" for key, one in value.items()
        )
    else:
        text = str(value)
    if text.startswith("sha256:"):
        return short_digest(text)
    return text if len(text) <= 80 else f"{text[:79]}…"
