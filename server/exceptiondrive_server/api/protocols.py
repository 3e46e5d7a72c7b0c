"""Protocols and their tasks."""

from typing import Annotated, Literal

from fastapi import APIRouter, Path, Query
from fastapi.responses import Response
from pydantic import BaseModel

from exceptiondrive_records.protocols import find_protocol, find_protocol_row, list_protocols
from exceptiondrive_schemas.problems import ProblemCode
from exceptiondrive_schemas.protocol import Protocol
from exceptiondrive_schemas.taxonomy import Taxonomy
from exceptiondrive_server.auth import ServicesOf
from exceptiondrive_server.problems import problem_responses

router = APIRouter(tags=["protocols"])


class ProtocolHead(BaseModel):
    """A protocol in a list."""

    version: str
    digest: str
    title: str
    changes: str


@router.get("/protocols", operation_id="listProtocols", responses=problem_responses())
def get_protocols(services: ServicesOf) -> list[ProtocolHead]:
    """List all protocols, oldest first."""
    with services.database.read() as session:
        protocols = list_protocols(session)
    return [
        ProtocolHead(version=p.version, digest=p.digest, title=p.title, changes=p.changes)
        for p in protocols
    ]


@router.get(
    "/protocols/{version}",
    operation_id="showProtocol",
    response_class=Response,
    responses={
        200: {"model": Protocol, "description": "The protocol, as JSON or as its TOML document."},
        **problem_responses(ProblemCode.NOT_FOUND),
    },
)
def get_protocol(
    services: ServicesOf,
    version: Annotated[str, Path(max_length=100, description="version or digest")],
    format: Annotated[Literal["json", "toml"], Query()] = "json",
) -> Response:
    """Give a protocol: every constant that turns a trajectory into a score."""
    with services.database.read() as session:
        if format == "toml":
            toml = find_protocol_row(session, version).toml
            return Response(toml, media_type="application/toml")
        protocol = find_protocol(session, version)
    return Response(protocol.model_dump_json(by_alias=True), media_type="application/json")


@router.get("/tasks", operation_id="listTasks", responses=problem_responses(ProblemCode.NOT_FOUND))
def get_tasks(
    services: ServicesOf,
    protocol: Annotated[str | None, Query(max_length=100, description="else the newest")] = None,
) -> Taxonomy:
    """Give the taxonomy of a protocol: six families, 21 tasks."""
    with services.database.read() as session:
        if protocol is None:
            return list_protocols(session)[-1].taxonomy
        return find_protocol(session, protocol).taxonomy
