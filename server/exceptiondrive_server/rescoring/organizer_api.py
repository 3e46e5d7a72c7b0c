"""Rescoring runs, controlled by organizers. Every step needs a reason, and none edits a score."""

from collections.abc import Callable
from typing import Annotated

from fastapi import APIRouter, Path, Query
from fastapi.responses import Response
from pydantic import Field, StrictInt

from exceptiondrive_records.rescoring import changes, flip, verification
from exceptiondrive_records.rescoring.runs import find_run
from exceptiondrive_records.rescoring.tables import RescoringRun
from exceptiondrive_records.rescoring.views import preview_of, run_view, run_views
from exceptiondrive_schemas.api.rescoring import PreviewView, RunView, VerificationView
from exceptiondrive_server.rescoring.exports import comparison_csv
from exceptiondrive_server.web.auth import Organizer, ServicesOf
from exceptiondrive_server.web.forms import Action
from exceptiondrive_server.web.services import Services

router = APIRouter()
RunId = Annotated[str, Path(max_length=64, description="of the run")]
PhaseQuery = Annotated[str | None, Query(max_length=64, description="only of this phase")]


class NewRun(Action):
    """A run to be drafted: a protocol, a split revision, or both."""

    phase: Annotated[str, Field(max_length=64)]
    protocol: Annotated[str, Field(max_length=100)] | None = None
    split_revision: Annotated[str, Field(max_length=100)] | None = None


class ApplyStep(Action):
    """The step that readers see."""

    preview: Annotated[str, Field(max_length=100)]
    """Digest of the preview that was looked at."""


class NewVerification(Action):
    """Sheets to be recomputed; without a sample all of them."""

    phase: Annotated[str, Field(max_length=64)]
    sample: Annotated[StrictInt, Field(ge=1, le=100_000)] | None = None


@router.get("/rescoring", operation_id="listRuns")
def get_runs(services: ServicesOf, phase: PhaseQuery = None) -> list[RunView]:
    """List rescoring runs, newest first."""
    with services.database.read() as session:
        return run_views(session, phase)


@router.post("/rescoring", operation_id="draftRun", status_code=201)
def post_run(services: ServicesOf, organizer: Organizer, wanted: NewRun) -> RunView:
    """Draft a run: nothing is scored yet."""
    with services.database.write() as session:
        given = wanted.model_dump()
        run = changes.create_run(session, given.pop("phase"), **given, actor=organizer.actor)
        return run_view(session, run)


@router.get("/rescoring/verifications", operation_id="listVerifications")
def get_verifications(services: ServicesOf, phase: PhaseQuery = None) -> list[VerificationView]:
    """List verifications, newest first."""
    with services.database.read() as session:
        return verification.list_verifications(session, phase)


@router.post("/rescoring/verifications", operation_id="startVerification", status_code=202)
def post_verification(
    services: ServicesOf, organizer: Organizer, wanted: NewVerification
) -> VerificationView:
    """Recompute sheets from their uploads, and compare every bit."""
    with services.database.write() as session:
        given = wanted.model_dump()
        started = changes.start_verification(
            session, given.pop("phase"), **given, actor=organizer.actor
        )
        return verification.verification_view(session, started.id)


@router.get("/rescoring/verifications/{verification_id}", operation_id="showVerification")
def get_verification(
    services: ServicesOf, verification_id: Annotated[str, Path(max_length=64)]
) -> VerificationView:
    """Show progress and outcome of a verification."""
    with services.database.read() as session:
        return verification.verification_view(session, verification_id)


@router.get("/rescoring/{run_id}", operation_id="showRun")
def get_run(services: ServicesOf, run_id: RunId) -> RunView:
    """Show state, progress and blockers of a run."""
    with services.database.read() as session:
        return run_view(session, find_run(session, run_id))


@router.get("/rescoring/{run_id}/preview", operation_id="previewRun")
def get_preview(
    services: ServicesOf,
    run_id: RunId,
    seen: Annotated[
        str | None, Query(max_length=100, description="digest of an earlier preview")
    ] = None,
) -> PreviewView:
    """Compare every entry before and after, worst movers first."""
    with services.database.read() as session:
        return preview_of(session, run_id, seen)


@router.get(
    "/rescoring/{run_id}/preview.csv",
    operation_id="downloadPreview",
    response_class=Response,
    responses={200: {"content": {"text/csv": {"schema": {"type": "string"}}}}},
)
def get_preview_csv(services: ServicesOf, run_id: RunId) -> Response:
    """Download the comparison as CSV, a line per entry."""
    with services.database.read() as session:
        preview = preview_of(session, run_id)
    return Response(comparison_csv(preview.comparison, preview.direction), media_type="text/csv")


@router.post("/rescoring/{run_id}/start", operation_id="startRun")
def post_start(
    services: ServicesOf, organizer: Organizer, run_id: RunId, action: Action
) -> RunView:
    """Start scoring in the background."""
    return _step(services, changes.start_run, organizer.actor, run_id, action)


@router.post("/rescoring/{run_id}/pause", operation_id="pauseRun")
def post_pause(
    services: ServicesOf, organizer: Organizer, run_id: RunId, action: Action
) -> RunView:
    """Pause a run: no further sheet of it begins."""
    return _step(services, changes.pause_run, organizer.actor, run_id, action)


@router.post("/rescoring/{run_id}/resume", operation_id="resumeRun")
def post_resume(
    services: ServicesOf, organizer: Organizer, run_id: RunId, action: Action
) -> RunView:
    """Resume a run, and retry failed sheets."""
    return _step(services, changes.resume_run, organizer.actor, run_id, action)


@router.post("/rescoring/{run_id}/cancel", operation_id="cancelRun")
def post_cancel(
    services: ServicesOf, organizer: Organizer, run_id: RunId, action: Action
) -> RunView:
    """Cancel a run that was not applied; the board did not change."""
    return _step(services, changes.cancel_run, organizer.actor, run_id, action)


@router.post("/rescoring/{run_id}/apply", operation_id="applyRun")
def post_apply(
    services: ServicesOf, organizer: Organizer, run_id: RunId, step: ApplyStep
) -> RunView:
    """Show the new board, in one transaction; refused while anything is missing or stale."""
    flip.work_out(services.database, run_id)
    with services.database.write() as session:
        flip.apply_run(session, run_id, **step.model_dump(), actor=organizer.actor)
    return get_run(services, run_id)


@router.post("/rescoring/{run_id}/rollback", operation_id="rollbackRun")
def post_rollback(
    services: ServicesOf, organizer: Organizer, run_id: RunId, action: Action
) -> RunView:
    """Show the board under the earlier protocol again."""
    flip.work_out(services.database, run_id)
    return _step(services, flip.rollback_run, organizer.actor, run_id, action)


@router.post("/rescoring/{run_id}/close", operation_id="closeRun")
def post_close(
    services: ServicesOf, organizer: Organizer, run_id: RunId, action: Action
) -> RunView:
    """Close an applied run: it can no longer be rolled back."""
    return _step(services, changes.close_run, organizer.actor, run_id, action)


def _step(
    services: Services, take: Callable[..., RescoringRun], actor: str, run_id: str, action: Action
) -> RunView:
    with services.database.write() as session:
        take(session, run_id, reason=action.reason, actor=actor)
    return get_run(services, run_id)
