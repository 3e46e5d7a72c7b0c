"""The published formats: JSON Schema and one small valid example of every file."""

from typing import Annotated, Any

from fastapi import APIRouter, Path
from fastapi.responses import Response

from exceptiondrive_records.db.errors import NotFound
from exceptiondrive_schemas.api.problems import ProblemCode
from exceptiondrive_schemas.published import DOCUMENT_NAMES, example_text, schema_text
from exceptiondrive_server.web.problems import problem_responses

router = APIRouter(tags=["documents"])
DocumentName = Annotated[str, Path(max_length=64, json_schema_extra={"enum": list(DOCUMENT_NAMES)})]
SCHEMA_MEDIA_TYPE = "application/schema+json"


def _responses(media_type: str) -> dict[int | str, dict[str, Any]]:
    content = {media_type: {"schema": {"type": "object"}}}
    return {
        200: {"content": content, "description": "The document."},
        **problem_responses(ProblemCode.NOT_FOUND),
    }


@router.get("/schemas", operation_id="listSchemas", responses=problem_responses())
def get_schemas() -> list[str]:
    """List the documents that have a schema and an example."""
    return list(DOCUMENT_NAMES)


@router.get(
    "/schemas/{name}",
    operation_id="showSchema",
    response_class=Response,
    responses=_responses(SCHEMA_MEDIA_TYPE),
)
def get_schema(name: DocumentName) -> Response:
    """Get the JSON Schema of a document."""
    return Response(schema_text(_require_document(name)), media_type=SCHEMA_MEDIA_TYPE)


@router.get(
    "/examples/{name}",
    operation_id="showExample",
    response_class=Response,
    responses=_responses("application/json"),
)
def get_example(name: DocumentName) -> Response:
    """Get a small valid example of a document."""
    return Response(example_text(_require_document(name)), media_type="application/json")


def _require_document(name: str) -> str:
    if name not in DOCUMENT_NAMES:
        raise NotFound("document", name)
    return name
