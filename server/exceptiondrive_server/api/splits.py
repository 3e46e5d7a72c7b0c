"""Development splits: the whole file, regions included. Hidden splits are not found here."""

from typing import Annotated

from fastapi import APIRouter, Path, Request
from fastapi.responses import Response

from exceptiondrive_records.errors import NotFound
from exceptiondrive_records.splits import find_split
from exceptiondrive_schemas.problems import ProblemCode
from exceptiondrive_schemas.split import Split
from exceptiondrive_server.auth import ServicesOf
from exceptiondrive_server.etag import matches
from exceptiondrive_server.problems import problem_responses

router = APIRouter(prefix="/splits", tags=["splits"])
MAX_SPLIT_BYTES = 64 * 1024 * 1024
GZIP_MAGIC = b"\x1f\x8b"


@router.get(
    "/{name}",
    operation_id="downloadSplit",
    response_class=Response,
    responses={
        200: {"model": Split, "description": "The split file."},
        304: {"description": "The asker's copy is the current one."},
        **problem_responses(ProblemCode.NOT_FOUND),
    },
)
def download_split(
    request: Request,
    services: ServicesOf,
    name: Annotated[str, Path(max_length=64, description="name of a split")],
) -> Response:
    """Download a development split with its regions, for `exceptiondrive evaluate`."""
    with services.database.read() as session:
        digest = find_split(session, name).public_file_digest
    if digest is None:
        raise NotFound("split", name)
    etag = f'"{digest}"'
    headers = {"ETag": etag, "Cache-Control": "public, max-age=3600"}
    if matches(request.headers.get("if-none-match"), etag):
        return Response(status_code=304, headers=headers)
    data = services.files.read(digest, limit_bytes=MAX_SPLIT_BYTES)
    if data.startswith(GZIP_MAGIC):
        headers["Content-Encoding"] = "gzip"
    return Response(data, media_type="application/json", headers=headers)
