"""Protocols and their tasks."""

from typing import Annotated, Literal

from fastapi import APIRouter, Path, Query, Request
from fastapi.responses import Response
from pydantic import BaseModel

from exceptiondrive_records.protocols.protocols import find_protocol_row
from exceptiondrive_records.protocols.shown import shown_protocol, shown_protocols
from exceptiondrive_schemas.api.problems import ProblemCode
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.taxonomy import Taxonomy
from exceptiondrive_server.boards.queries import featured_protocol
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.compression import takes
from exceptiondrive_server.web.etag import UNCHANGED, conditional
from exceptiondrive_server.web.problems import problem_responses

router = APIRouter(tags=["protocols"])
TOML = "application/toml"
FRESH_S = 3600


class ProtocolHead(BaseModel):
    """A protocol in a list."""

    version: str
    digest: str
    title: str
    changes: str


def protocol_head(protocol: ProtocolDocument) -> ProtocolHead:
    """Return a protocol as it stands in a list."""
    return ProtocolHead.model_validate(protocol, from_attributes=True)


@router.get("/protocols", operation_id="listProtocols", responses=problem_responses())
def get_protocols(services: ServicesOf) -> list[ProtocolHead]:
    """List the protocols that phases use or used, oldest first."""
    with services.database.read() as session:
        return [protocol_head(protocol) for protocol in shown_protocols(session)]


@router.get(
    "/protocols/{version}",
    operation_id="showProtocol",
    response_class=Response,
    responses={
        200: {
            "model": ProtocolDocument,
            "content": {TOML: {"schema": {"type": "string"}}},
            "description": "The protocol, as JSON or as its TOML document.",
        },
        304: UNCHANGED,
        **problem_responses(ProblemCode.NOT_FOUND),
    },
)
def get_protocol(
    request: Request,
    services: ServicesOf,
    version: Annotated[str, Path(max_length=100, description="version or digest")],
    form: Annotated[
        Literal["json", "toml"] | None,
        Query(alias="format", description="else TOML where the Accept header takes it"),
    ] = None,
) -> Response:
    """Get a protocol: every constant that turns a trajectory into a score."""
    wants_toml = form == "toml" or (form is None and takes(request.headers.get("accept", ""), TOML))
    with services.database.read() as session:
        protocol = shown_protocol(session, version)
        text = find_protocol_row(session, protocol.digest).toml
    body = text if wants_toml else protocol.model_dump_json(by_alias=True)
    media_type = TOML if wants_toml else "application/json"
    answer = conditional(request, body.encode(), media_type, max_age_s=FRESH_S)
    answer.headers["Vary"] = "Accept"
    return answer


@router.get("/tasks", operation_id="listTasks", responses=problem_responses(ProblemCode.NOT_FOUND))
def get_tasks(
    services: ServicesOf,
    protocol: Annotated[
        str | None, Query(max_length=100, description="else that of the front page")
    ] = None,
) -> Taxonomy:
    """Get the taxonomy of a protocol: its families and tasks, with the required clearances."""
    with services.database.read() as session:
        asked = shown_protocol(session, protocol) if protocol else featured_protocol(session)
    taxonomy, scale = asked.taxonomy, asked.grading.d_safe_scale
    scaled = [it.model_copy(update={"d_safe_m": it.d_safe_m * scale}) for it in taxonomy.tasks]
    return taxonomy.model_copy(update={"tasks": tuple(scaled)})
