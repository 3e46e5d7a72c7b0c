"""Public notes on disqualifications, and the terms that teams accept."""

from datetime import datetime
from typing import Annotated

from fastapi import APIRouter
from pydantic import BaseModel, Field

from exceptiondrive_records.phases.disqualified import disqualification_notes
from exceptiondrive_records.phases.phases import shown_phase
from exceptiondrive_records.phases.terms import accept_terms
from exceptiondrive_schemas.api.participation import DisqualificationNote
from exceptiondrive_schemas.api.problems import ProblemCode
from exceptiondrive_server.web.auth import (
    TOKEN_IS_OPTIONAL,
    MaybePrincipal,
    ServicesOf,
    Submitter,
    sees_hidden,
    team_of,
)
from exceptiondrive_server.web.forms import Form
from exceptiondrive_server.web.path_ids import PhaseId
from exceptiondrive_server.web.problems import problem_responses

router = APIRouter(prefix="/phases", tags=["phases"])


class AcceptTerms(Form):
    """The version that was read."""

    version: Annotated[str, Field(min_length=1, max_length=64)]


class TermsAccepted(BaseModel):
    """That a team accepted the terms."""

    phase: str
    version: str
    accepted_at: datetime


@router.get(
    "/{phase_id}/disqualifications",
    operation_id="listDisqualificationNotes",
    openapi_extra=TOKEN_IS_OPTIONAL,
    responses=problem_responses(ProblemCode.NOT_FOUND, ProblemCode.NOT_SIGNED_IN),
)
def get_disqualification_notes(
    services: ServicesOf, principal: MaybePrincipal, phase_id: PhaseId
) -> list[DisqualificationNote]:
    """List disqualified teams and submissions of the phase, as far as organizers made them public."""
    with services.database.read() as session:
        phase = shown_phase(session, phase_id, with_hidden=sees_hidden(principal))
        return list(disqualification_notes(session, phase))


@router.post(
    "/{phase_id}/terms",
    operation_id="acceptTerms",
    responses=problem_responses(
        ProblemCode.NOT_SIGNED_IN,
        ProblemCode.NOT_ALLOWED,
        ProblemCode.NOT_FOUND,
        ProblemCode.CONFLICT,
    ),
)
def post_terms(
    services: ServicesOf, submitter: Submitter, phase_id: PhaseId, accepted: AcceptTerms
) -> TermsAccepted:
    """Accept the terms of a phase for the team, in the version that was read; idempotent."""
    with services.database.write() as session:
        phase = shown_phase(session, phase_id)
        row = accept_terms(
            session, team_of(submitter), phase, accepted.version, actor=submitter.actor
        )
        return TermsAccepted(phase=phase.id, version=row.version, accepted_at=row.accepted_at)
