"""Splits, as organizers see them: every registered revision."""

from datetime import datetime

from fastapi import APIRouter
from pydantic import BaseModel

from exceptiondrive_records.splits.splits import list_splits
from exceptiondrive_schemas.api.phase_settings import SplitPart
from exceptiondrive_schemas.datasheet import SplitWarning
from exceptiondrive_server.web.auth import ServicesOf

router = APIRouter()


class SplitView(BaseModel):
    """A registered split revision."""

    name: str
    revision: str
    title: str
    n_samples: int
    is_public: bool
    part: SplitPart | None = None
    public_revision: str | None = None
    """Of a whole split: its public part, where it has parts."""
    private_revision: str | None = None
    registered_at: datetime
    words: str = ""
    """What its makers say of it, where it is a later revision."""
    warnings: tuple[SplitWarning, ...] = ()


@router.get("/splits", operation_id="listSplits")
def get_splits(services: ServicesOf) -> list[SplitView]:
    """List the registered split revisions, which phases may use."""
    with services.database.read() as session:
        return [
            SplitView(
                name=split.name,
                revision=split.revision,
                title=split.title,
                n_samples=split.n_samples,
                is_public=split.public_file_digest is not None,
                part=split.part,
                public_revision=split.public_revision,
                private_revision=split.private_revision,
                registered_at=split.registered_at,
                words="" if split.changes is None else split.changes.words,
                warnings=split.warnings.found,
            )
            for split in list_splits(session)
        ]
