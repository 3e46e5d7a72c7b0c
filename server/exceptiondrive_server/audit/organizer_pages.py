"""The audit log: pages, filters, verification."""

from datetime import date
from typing import Annotated, Literal
from urllib.parse import urlencode

from fastapi import APIRouter, Query
from fastapi.responses import Response

from exceptiondrive_records.audit.log import audit_actions, verify_audit
from exceptiondrive_schemas.base import in_words
from exceptiondrive_schemas.datetimes import first_moment
from exceptiondrive_server.audit.queries import history
from exceptiondrive_server.web.organizer_frame import OrganizerBrowser, organizer_page

router = APIRouter(prefix="/organize/audit", include_in_schema=False)
SHOWN = 50
Filter = Annotated[str, Query(max_length=200)]
Day = Annotated[date | Literal[""], in_words("must be a day such as 2026-11-21"), Query()]
"""As the field of a form sends it: empty where none is chosen."""


@router.get("")
def show_audit(
    browser: OrganizerBrowser,
    actor: Filter = "",
    subject: Filter = "",
    before: Annotated[int | None, Query(ge=1, lt=2**31)] = None,
    verify: bool = False,
    since: Day = "",
    action: Filter = "",
) -> Response:
    """Show the log, newest first; with `verify` recompute the whole chain."""
    actor, subject = actor.strip(), subject.strip()
    with browser.services.database.read() as session:
        lines = history(
            session,
            subject,
            actor=actor,
            before=before,
            since=first_moment(since) if since else None,
            action=action,
            limit=SHOWN + 1,
        )
        verdict = verify_audit(session) if verify else None
        actions = audit_actions(session)
    told = {"actor": actor, "subject": subject, "action": action, "since": str(since)}
    older = dict(told)
    if len(lines) > SHOWN:
        older["before"] = str(lines[SHOWN - 1].line.id)
    return organizer_page(
        browser,
        "audit/organizer_audit.html",
        "audit",
        lines=lines[:SHOWN],
        told=told,
        actions=[(action, action) for action in actions],
        older="before" in older and urlencode({k: v for k, v in older.items() if v}),
        verdict=verdict,
        is_newest=before is None,
    )
