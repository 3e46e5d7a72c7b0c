"""The published forms: JSON Schema and one small valid example of every file."""

from enum import StrEnum

from fastapi import APIRouter
from fastapi.responses import Response

from exceptiondrive_schemas.problems import ProblemCode
from exceptiondrive_schemas.published import DOCUMENT_NAMES, example_text, schema_text
from exceptiondrive_server.problems import problem_responses

router = APIRouter(tags=["documents"])
DocumentName = StrEnum("DocumentName", {name: name for name in DOCUMENT_NAMES})
_RESPONSES = {
    200: {"content": {"application/json": {}}, "description": "The document."},
    **problem_responses(ProblemCode.NOT_FOUND),
}


@router.get("/schemas", operation_id="listSchemas", responses=problem_responses())
def get_schemas() -> list[str]:
    """Name the documents that have a schema and an example."""
    return list(DOCUMENT_NAMES)


@router.get(
    "/schemas/{name}", operation_id="showSchema", response_class=Response, responses=_RESPONSES
)
def get_schema(name: DocumentName) -> Response:
    """Give the JSON Schema of a document."""
    return Response(schema_text(name.value), media_type="application/schema+json")


@router.get(
    "/examples/{name}", operation_id="showExample", response_class=Response, responses=_RESPONSES
)
def get_example(name: DocumentName) -> Response:
    """Give a small valid example of a document."""
    return Response(example_text(name.value), media_type="application/json")
