"""Which submissions are alike, for organizers alone."""

from typing import Annotated

from fastapi import APIRouter, Path

from exceptiondrive_records.similarity import similarity_report
from exceptiondrive_schemas.similarity import SimilarityReport
from exceptiondrive_server.auth import ServicesOf

router = APIRouter()


@router.get("/phases/{phase_id}/similar", operation_id="showSimilar")
def get_similar(
    services: ServicesOf, phase_id: Annotated[str, Path(max_length=64)]
) -> SimilarityReport:
    """Show teams with equal or near-equal submissions, and teams that change few samples at a time.

    Reasons to ask a team, not proof: planners that both stand still are alike, too.
    """
    with services.database.read() as session:
        return similarity_report(session, phase_id)
