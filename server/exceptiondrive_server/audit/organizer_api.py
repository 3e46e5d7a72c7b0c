"""The audit log, as organizers read and verify it."""

from typing import Annotated

from fastapi import APIRouter, Query
from pydantic import BaseModel, Field

from exceptiondrive_records.audit.log import audit_page, verify_audit
from exceptiondrive_schemas.base import in_words
from exceptiondrive_schemas.datetimes import Moment, first_moment
from exceptiondrive_server.audit.queries import AuditLineView, line_view
from exceptiondrive_server.web.auth import ServicesOf

router = APIRouter()
Head = Annotated[
    str,
    Field(pattern="^[0-9a-f]{64}$"),
    in_words("must be the head that an earlier verification told: 64 digits 0-9 and a-f"),
]


class AuditVerdictView(BaseModel):
    """Whether the chain of the audit log is whole, and holds the head that was kept."""

    is_whole: bool
    n_lines: int
    head: str
    broken_at: int | None
    holds_kept_head: bool | None = None
    """Whether a line has the head that was sent along; null: none was."""


@router.get("/audit", operation_id="readAudit")
def get_audit(
    services: ServicesOf,
    before: Annotated[
        int | None, Query(ge=1, lt=2**31, description="only lines with a lower `id`")
    ] = None,
    limit: Annotated[int, Query(ge=1, le=500, description="how many at most")] = 100,
    actor: Annotated[str | None, Query(max_length=200, description="only by this one")] = None,
    subject: Annotated[str | None, Query(max_length=200, description="only about this")] = None,
    since: Annotated[
        Moment | None, Query(description="a time, or a day from its first moment in UTC")
    ] = None,
    action: Annotated[str | None, Query(max_length=200, description="only of this kind")] = None,
) -> list[AuditLineView]:
    """Read the audit log, newest first."""
    with services.database.read() as session:
        lines = audit_page(
            session,
            before=before,
            limit=limit,
            actor=actor,
            subject=subject,
            since=None if since is None else first_moment(since),
            action=action,
        )
        return list(map(line_view, lines))


@router.get("/audit/verify", operation_id="verifyAudit")
def get_audit_verdict(
    services: ServicesOf,
    head: Annotated[Head | None, Query(description="kept from an earlier verification")] = None,
) -> AuditVerdictView:
    """Recompute the chain to find altered, missing or reordered lines.

    With the `head` from an earlier verification, it also finds lines cut off at the end.
    """
    with services.database.read() as session:
        verdict = verify_audit(session, head)
    return AuditVerdictView.model_validate(verdict, from_attributes=True)
