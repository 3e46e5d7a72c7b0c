"""Protocol documents, as organizers check and add them."""

from typing import Annotated

from fastapi import APIRouter, Body, Query
from fastapi.responses import Response

from exceptiondrive_records.protocols.protocols import add_protocol, list_protocols
from exceptiondrive_records.rescoring.views import protocol_check
from exceptiondrive_schemas.protocol_difference import Difference
from exceptiondrive_server.protocols.api import ProtocolHead, protocol_head
from exceptiondrive_server.web.auth import Organizer, ServicesOf

router = APIRouter()
MAX_PROTOCOL_CHARACTERS = 200_000
PhaseQuery = Annotated[str | None, Query(max_length=64, description="only of this phase")]
Toml = Annotated[
    str,
    Body(media_type="application/toml", min_length=1, max_length=MAX_PROTOCOL_CHARACTERS),
]


@router.post("/protocols/check", operation_id="checkProtocol")
def post_protocol_check(
    services: ServicesOf,
    toml: Toml,
    phase: PhaseQuery = None,
) -> Difference:
    """Validate a protocol document and say in plain words what it changes; nothing is kept."""
    with services.database.read() as session:
        return protocol_check(session, toml, phase)


@router.post(
    "/protocols",
    operation_id="addProtocol",
    status_code=201,
    responses={200: {"model": ProtocolHead, "description": "This very document is there already."}},
)
def post_protocol(
    response: Response,
    services: ServicesOf,
    organizer: Organizer,
    toml: Toml,
) -> ProtocolHead:
    """Add a protocol document; it is immutable from then on."""
    with services.database.write() as session:
        n_before = len(list_protocols(session))
        added = add_protocol(session, toml, organizer.actor)
        if len(list_protocols(session)) == n_before:
            response.status_code = 200
    return protocol_head(added)
