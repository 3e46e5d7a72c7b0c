"""Phases and the manifests of their splits."""

from typing import Annotated

from fastapi import APIRouter, Query, Response

from exceptiondrive_records.phases.phases import list_phases, phase_view, shown_phase
from exceptiondrive_records.splits.splits import manifest_of
from exceptiondrive_schemas.api.phase_report import PhaseReport
from exceptiondrive_schemas.api.problems import ProblemCode
from exceptiondrive_schemas.api.submission import PhaseView
from exceptiondrive_schemas.challenges import KnownChallenge
from exceptiondrive_schemas.split import Manifest
from exceptiondrive_server.phases.report import report_of
from exceptiondrive_server.web.auth import (
    TOKEN_IS_OPTIONAL,
    MaybePrincipal,
    ServicesOf,
    sees_hidden,
)
from exceptiondrive_server.web.path_ids import PhaseId
from exceptiondrive_server.web.problems import QUOTA_HEADERS, problem_responses, quota_headers

router = APIRouter(prefix="/phases", tags=["phases"])


@router.get(
    "",
    operation_id="listPhases",
    openapi_extra=TOKEN_IS_OPTIONAL,
    responses=problem_responses(ProblemCode.NOT_SIGNED_IN),
)
def get_phases(
    services: ServicesOf,
    principal: MaybePrincipal,
    challenge: Annotated[KnownChallenge | None, Query(description="only of this challenge")] = None,
) -> list[PhaseView]:
    """List all phases; with a token, each with the team's own quota.

    Only organizers see hidden phases.
    """
    team_id = principal.team_id if principal else None
    limit = services.settings.max_upload_bytes
    with services.database.read() as session:
        return [
            phase_view(session, phase, max_upload_bytes=limit, team_id=team_id)
            for phase in list_phases(session, challenge, with_hidden=sees_hidden(principal))
        ]


@router.get(
    "/{phase_id}",
    operation_id="showPhase",
    openapi_extra=TOKEN_IS_OPTIONAL,
    responses={
        200: QUOTA_HEADERS,
        **problem_responses(ProblemCode.NOT_FOUND, ProblemCode.NOT_SIGNED_IN),
    },
)
def get_phase(
    response: Response, services: ServicesOf, principal: MaybePrincipal, phase_id: PhaseId
) -> PhaseView:
    """Get one phase; with a team's token, headers say what it may still submit."""
    with services.database.read() as session:
        view = phase_view(
            session,
            shown_phase(session, phase_id, with_hidden=sees_hidden(principal)),
            max_upload_bytes=services.settings.max_upload_bytes,
            team_id=principal.team_id if principal else None,
        )
    if view.quota is not None:
        response.headers.update(quota_headers(view.quota))
    return view


@router.get(
    "/{phase_id}/manifest",
    operation_id="showManifest",
    openapi_extra=TOKEN_IS_OPTIONAL,
    responses=problem_responses(ProblemCode.NOT_FOUND, ProblemCode.NOT_SIGNED_IN),
)
def get_manifest(services: ServicesOf, principal: MaybePrincipal, phase_id: PhaseId) -> Manifest:
    """Get the sample ids that a submission file must contain, without tasks, regions or scenes."""
    with services.database.read() as session:
        phase = shown_phase(session, phase_id, with_hidden=sees_hidden(principal))
        manifest = manifest_of(session, phase.split_name, phase.split_revision)
        return manifest.model_copy(update={"challenge": phase.challenge})


@router.get(
    "/{phase_id}/report",
    operation_id="showReport",
    openapi_extra=TOKEN_IS_OPTIONAL,
    responses=problem_responses(ProblemCode.NOT_FOUND, ProblemCode.NOT_SIGNED_IN),
)
def get_report(services: ServicesOf, principal: MaybePrincipal, phase_id: PhaseId) -> PhaseReport:
    """Get the final report of a phase, made from its boards: winners, changes by a reveal, flags, counts."""
    with services.database.read() as session:
        phase = shown_phase(session, phase_id, with_hidden=sees_hidden(principal))
        return report_of(session, phase)
