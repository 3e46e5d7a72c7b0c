"""The page of a split, from its datasheet and lint; pictures of public ones. Opens no split."""

from base64 import b64encode
from typing import Annotated

from fastapi import APIRouter, Path, Query, Request
from fastapi.responses import Response

from exceptiondrive_records.db.errors import NotFound
from exceptiondrive_records.phases.phases import list_phases
from exceptiondrive_records.splits.pictures import shows_picture
from exceptiondrive_records.splits.shown import is_kept_back, shown_revisions
from exceptiondrive_records.splits.tables import SamplePictureRow
from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_schemas.printable import percent_of
from exceptiondrive_server.boards.queries import featured_protocol
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.etag import REVALIDATED, conditional
from exceptiondrive_server.web.responses import SECURITY_HEADERS, page
from exceptiondrive_server.web.templating import template_filter

router = APIRouter(include_in_schema=False)
WORDS = (
    ("purpose", "For what purpose"),
    ("source", "Made from"),
    ("uses", "For what it is, and for what not"),
    ("limits", "Known limits"),
    ("maintenance", "Who keeps it"),
    ("contact", "Contact"),
)
MAX_PICTURE_BYTES = 32 * 2**20
template_filter(percent_of)
STAGES = {
    "screen": "Screening",
    "edit": "Editing",
    "review": "Review",
    "inspect": "Inspection",
    "localize": "Region proposed",
    "verify": "Region verified",
    "withdraw": "Withdrawal",
}


@router.get("/splits/{name}")
def show_split(
    request: Request,
    services: ServicesOf,
    name: Annotated[str, Path(max_length=64)],
    revision: Annotated[str | None, Query(max_length=80)] = None,
) -> Response:
    """Show how a split was made."""
    with services.database.read() as session:
        rows = shown_revisions(session, name)
        found = [row for row in rows if revision in (None, row.revision)]
        if not found:
            raise NotFound("split", name)
        sheet = found[0].datasheet
        phases = [phase for phase in list_phases(session) if phase.split_name == name]
        families = {it.id: it.title for it in featured_protocol(session).families}
    return page(
        request,
        "splits/split.html",
        "protocol",
        split=found[0],
        sheet=sheet,
        revisions=rows,
        phases=phases,
        challenges=CHALLENGES,
        families=families,
        words=WORDS,
        stages=STAGES,
    )


@router.get("/splits/{name}/pictures/{digest}.jpg")
def show_picture(
    request: Request,
    services: ServicesOf,
    name: Annotated[str, Path(max_length=64)],
    digest: Annotated[str, Path(max_length=64)],
) -> Response:
    """Give a picture of a sample of a public split that is shown; of others there is none."""
    file_digest = f"sha256:{digest}"
    with services.database.read() as session:
        is_shown = shows_picture(session, name, file_digest) and not is_kept_back(session, name)
    if not is_shown:
        raise NotFound("picture", digest)
    return conditional(
        request,
        lambda: services.files.read(file_digest, limit_bytes=MAX_PICTURE_BYTES),
        "image/jpeg",
        etag=digest,
        headers={**REVALIDATED, **SECURITY_HEADERS},
    )


@template_filter
def picture_address(picture: SamplePictureRow) -> str:
    """Where a picture of a sample is served, named by its content."""
    digest = picture.file_digest.removeprefix("sha256:")
    return f"/splits/{picture.split_name}/pictures/{digest}.jpg"


@template_filter
def jpeg_address(data: bytes) -> str:
    """A picture as an address that holds it."""
    return f"data:image/jpeg;base64,{b64encode(data).decode()}"
