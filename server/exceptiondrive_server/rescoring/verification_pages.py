"""Verifications: sheets are recomputed from their uploads, and every bit must come again."""

from typing import Annotated

from fastapi import APIRouter, Path, Query, Request
from fastapi.responses import Response
from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.tokens import names_of_actors
from exceptiondrive_records.db.errors import RecordsError
from exceptiondrive_records.phases.phases import list_phases
from exceptiondrive_records.rescoring.runs import start_verification
from exceptiondrive_records.rescoring.verification import verification_view
from exceptiondrive_schemas.form_fields import FormField
from exceptiondrive_server.accounts.browser_session import PostedForm
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.forms import REASON, read, typed
from exceptiondrive_server.web.organizer_frame import (
    OrganizerBrowser,
    Step,
    go,
    organizer_page,
    step_page,
)

router = APIRouter(prefix="/organize/verifications", include_in_schema=False)


@router.get("/new")
def show_new(
    request: Request,
    services: ServicesOf,
    browser: OrganizerBrowser,
    phase: Annotated[str, Query(max_length=64)] = "",
) -> Response:
    """Ask which sheets to recompute."""
    with services.database.read() as session:
        step = _step(session)
    return step_page(request, browser, step, texts={"phase": phase})


@router.post("/new")
def post_new(
    request: Request, services: ServicesOf, browser: OrganizerBrowser, form: PostedForm
) -> Response:
    """Start a verification."""
    with services.database.read() as session:
        step = _step(session)
    try:
        values = read(step.fields, form)
        with services.database.write() as session:
            started = start_verification(
                session,
                values["phase"],
                sample=values["sample"],
                reason=values["reason"],
                actor=browser.principal.actor,
            ).id
    except RecordsError as refusal:
        return step_page(request, browser, step, texts=typed(form), refusal=refusal)
    return go(f"/organize/verifications/{started}", "verification_started")


@router.get("/{verification_id}")
def show_verification(
    request: Request,
    services: ServicesOf,
    browser: OrganizerBrowser,
    verification_id: Annotated[str, Path(max_length=64)],
) -> Response:
    """Show what a verification has come to."""
    with services.database.read() as session:
        seen = verification_view(session, verification_id)
        names = names_of_actors(session, [seen.actor])
    return organizer_page(
        request,
        browser,
        "rescoring/organizer_verification.html",
        "rescoring",
        seen=seen,
        organizer_name=names.get(seen.actor, seen.actor),
    )


def _step(session: Session) -> Step:
    phases = tuple((one.id, one.title) for one in list_phases(session))
    return Step(
        section="rescoring",
        title="Verify sheets",
        meaning="Workers recompute sheets from their uploads over an empty store, and demand the "
        "same digest of the unrounded sheet. Nothing is changed; what differs is named.",
        button="Verify",
        back="/organize/rescoring",
        back_words="Rescoring",
        fields=(
            FormField("phase", "Phase", "choice", is_required=True, options=phases),
            FormField("sample", "How many sheets", "whole", "empty: all", highest=100_000),
            REASON,
        ),
        command='exceptiondrive organizer rescore verify --phase PHASE --sample all --reason "…"',
    )
