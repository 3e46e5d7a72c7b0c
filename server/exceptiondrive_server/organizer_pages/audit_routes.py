"""The audit log: paged, filtered, and verified."""

from typing import Annotated

from fastapi import APIRouter, Query, Request
from fastapi.responses import Response

from exceptiondrive_records.audit import audit_page, verify_audit
from exceptiondrive_records.tokens import names_of_actors
from exceptiondrive_server.auth import ServicesOf
from exceptiondrive_server.organizer_pages.audit_view import audit_view
from exceptiondrive_server.organizer_pages.frame import OrganizerBrowser, organizer_page

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
    return organizer_page(request, browser, "audit.html", "audit", page=content)
