"""Phases and the manifests of their splits."""

from typing import Annotated

from fastapi import APIRouter, Path

from exceptiondrive_records.phases.phases import find_phase, list_phases, phase_view
from exceptiondrive_records.splits.splits import manifest_of
from exceptiondrive_schemas.challenges import KnownChallenge
from exceptiondrive_schemas.problems import ProblemCode
from exceptiondrive_schemas.split import Manifest
from exceptiondrive_schemas.submission import PhaseView
from exceptiondrive_server.web.auth import TOKEN_IS_OPTIONAL, MaybePrincipal, ServicesOf
from exceptiondrive_server.web.problems import problem_responses

router = APIRouter(prefix="/phases", tags=["phases"])
PhaseId = Annotated[str, Path(max_length=64, description="id of a phase")]


@router.get(
    "",
    operation_id="listPhases",
    openapi_extra=TOKEN_IS_OPTIONAL,
    responses=problem_responses(ProblemCode.NOT_SIGNED_IN),
)
def get_phases(
    services: ServicesOf, principal: MaybePrincipal, challenge: KnownChallenge | None = None
) -> list[PhaseView]:
    """List all phases; with a token, each with the team's own quota."""
    team_id = principal.team_id if principal else None
    limit = services.settings.max_upload_bytes
    with services.database.read() as session:
        return [
            phase_view(session, phase, max_upload_bytes=limit, team_id=team_id)
            for phase in list_phases(session, challenge)
        ]


@router.get(
    "/{phase_id}",
    operation_id="showPhase",
    openapi_extra=TOKEN_IS_OPTIONAL,
    responses=problem_responses(ProblemCode.NOT_FOUND, ProblemCode.NOT_SIGNED_IN),
)
def get_phase(services: ServicesOf, principal: MaybePrincipal, phase_id: PhaseId) -> PhaseView:
    """Show one phase."""
    with services.database.read() as session:
        return phase_view(
            session,
            find_phase(session, phase_id),
            max_upload_bytes=services.settings.max_upload_bytes,
            team_id=principal.team_id if principal else None,
        )


@router.get(
    "/{phase_id}/manifest",
    operation_id="showManifest",
    responses=problem_responses(ProblemCode.NOT_FOUND),
)
def get_manifest(services: ServicesOf, phase_id: PhaseId) -> Manifest:
    """Give the sample ids that a submission file must hold: no task, region or scene."""
    with services.database.read() as session:
        phase = find_phase(session, phase_id)
        return manifest_of(session, phase.split_name, phase.split_revision)
