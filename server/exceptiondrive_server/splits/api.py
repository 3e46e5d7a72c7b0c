"""Public splits: the whole file, regions included. Withheld splits answer 404."""

import gzip
from collections.abc import Iterator
from io import BytesIO
from typing import Annotated

from fastapi import APIRouter, Path, Query, Request
from fastapi.responses import Response, StreamingResponse

from exceptiondrive_records.db.errors import NotFound
from exceptiondrive_records.splits.shown import shown_file, shown_revision
from exceptiondrive_schemas.api.problems import ProblemCode
from exceptiondrive_schemas.check.inflate import GZIP_MAGIC
from exceptiondrive_schemas.datasheet import Datasheet
from exceptiondrive_schemas.split import Split
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.compression import takes_gzip
from exceptiondrive_server.web.etag import UNCHANGED, conditional
from exceptiondrive_server.web.problems import problem_responses

SplitName = Annotated[str, Path(max_length=64, description="name of a split")]
Revision = Annotated[str | None, Query(max_length=80, description="by default the one in force")]
router = APIRouter(prefix="/splits", tags=["splits"])
MAX_SPLIT_BYTES = 64 * 1024 * 1024


@router.get(
    "/{name}/datasheet",
    operation_id="getDatasheet",
    responses=problem_responses(ProblemCode.NOT_FOUND),
)
def get_datasheet(
    services: ServicesOf,
    name: SplitName,
    revision: Revision = None,
) -> Datasheet:
    """Get the datasheet of a split, which says how it was made, if its makers provided one."""
    with services.database.read() as session:
        sheet = shown_revision(session, name, revision).datasheet
    if sheet is None:
        raise NotFound("datasheet of split", name)
    return sheet


@router.get(
    "/{name}",
    operation_id="downloadSplit",
    response_class=Response,
    responses={
        200: {
            "model": Split,
            "description": "The split file, as gzip to who takes it; its ETag is of the file that is kept.",
        },
        304: UNCHANGED,
        **problem_responses(ProblemCode.NOT_FOUND),
    },
)
def download_split(
    request: Request,
    services: ServicesOf,
    name: SplitName,
    revision: Revision = None,
) -> Response:
    """Download a public split with its regions, for `exceptiondrive evaluate`."""
    with services.database.read() as session:
        digest = shown_file(session, name, revision).public_file_digest
    assert digest is not None
    answer = conditional(
        request,
        lambda: services.files.read(digest, limit_bytes=MAX_SPLIT_BYTES),
        "application/json",
        etag=digest,
        headers={
            "Cache-Control": "public, max-age=3600",
            "Content-Disposition": f'attachment; filename="{name}.json"',
            "Vary": "Accept-Encoding",
        },
    )
    if bytes(answer.body[:2]) != GZIP_MAGIC:
        return answer
    if takes_gzip(request.headers.get("accept-encoding", "")):
        answer.headers["Content-Encoding"] = "gzip"
        return answer
    del answer.headers["Content-Length"]
    return StreamingResponse(_inflated(bytes(answer.body)), headers=answer.headers)


def _inflated(data: bytes) -> Iterator[bytes]:
    with gzip.open(BytesIO(data)) as file:
        while part := file.read(64 * 1024):
            yield part
