"""Phases, and the splits that they may use, as organizers manage them."""

from typing import Annotated

from fastapi import APIRouter
from pydantic import BaseModel, Field, StrictBool, StrictInt

from exceptiondrive_records.phases import create_phase, phase_view
from exceptiondrive_records.splits import list_splits
from exceptiondrive_schemas.challenges import ChallengeId
from exceptiondrive_schemas.submission import PhaseView
from exceptiondrive_server.api.organizer_forms import Form
from exceptiondrive_server.api.times import Time
from exceptiondrive_server.auth import Organizer, ServicesOf

router = APIRouter()


class NewPhase(Form):
    """A phase to be made."""

    id: Annotated[str, Field(max_length=64)]
    challenge: ChallengeId
    title: Annotated[str, Field(max_length=400)]
    description: Annotated[str, Field(max_length=8000)] = ""
    split: Annotated[str, Field(max_length=64)]
    protocol: Annotated[str, Field(max_length=100)]
    opens_at: Time | None = None
    closes_at: Time | None = None
    quota_per_day: Annotated[StrictInt, Field(ge=1, le=10_000)] = 3
    quota_total: Annotated[StrictInt, Field(ge=1, le=1_000_000)] | None = None
    quota_concurrent: Annotated[StrictInt, Field(ge=1, le=10_000)] | None = None
    rejected_per_day: Annotated[StrictInt, Field(ge=1, le=10_000)] = 20
    shows_reported: StrictBool = False


class SplitView(BaseModel):
    """A registered split revision."""

    name: str
    revision: str
    title: str
    n_samples: int
    is_public: bool


@router.get("/splits", operation_id="listSplits")
def get_splits(services: ServicesOf) -> list[SplitView]:
    """List the registered split revisions: what a phase may use."""
    with services.database.read() as session:
        return [
            SplitView(
                name=split.name,
                revision=split.revision,
                title=split.title,
                n_samples=split.n_samples,
                is_public=split.public_file_digest is not None,
            )
            for split in list_splits(session)
        ]


@router.post("/phases", operation_id="createPhase", status_code=201)
def post_phase(services: ServicesOf, organizer: Organizer, phase: NewPhase) -> PhaseView:
    """Make a phase."""
    with services.database.write() as session:
        made = create_phase(
            session,
            phase.id,
            challenge=phase.challenge.value,
            title=phase.title,
            description=phase.description,
            split_name=phase.split,
            protocol=phase.protocol,
            opens_at=phase.opens_at,
            closes_at=phase.closes_at,
            quota_per_day=phase.quota_per_day,
            quota_total=phase.quota_total,
            quota_concurrent=phase.quota_concurrent,
            rejected_per_day=phase.rejected_per_day,
            shows_reported=phase.shows_reported,
            actor=organizer.actor,
        )
        limit = services.settings.max_upload_bytes
        return phase_view(session, made, max_upload_bytes=limit)
