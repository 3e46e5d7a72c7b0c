"""Protocol documents, as organizers add them."""

from typing import Annotated

from fastapi import APIRouter, Body, Response

from exceptiondrive_records.protocols import add_protocol, list_protocols
from exceptiondrive_server.api.protocols import ProtocolHead, protocol_head
from exceptiondrive_server.auth import Organizer, ServicesOf

router = APIRouter()
MAX_PROTOCOL_CHARACTERS = 200_000


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
    toml: Annotated[str, Body(media_type="application/toml", max_length=MAX_PROTOCOL_CHARACTERS)],
) -> ProtocolHead:
    """Add a protocol document; it is immutable from then on."""
    with services.database.write() as session:
        n_before = len(list_protocols(session))
        added = add_protocol(session, toml, organizer.actor)
        if len(list_protocols(session)) == n_before:
            response.status_code = 200
    return protocol_head(added)
