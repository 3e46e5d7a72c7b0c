"""Protocol documents, as organizers list, check, add and delete them."""

from datetime import datetime
from typing import Annotated

from fastapi import APIRouter, Body, Path, Query
from fastapi.responses import Response
from pydantic import BaseModel

from exceptiondrive_records.protocols.protocols import (
    add_protocol,
    delete_protocol,
    find_protocol_row,
    list_protocols,
)
from exceptiondrive_records.protocols.shown import shown_digests
from exceptiondrive_records.rescoring.views import protocol_check
from exceptiondrive_records.splits.confirmations import (
    add_confirmation,
    list_confirmations,
    withdraw_confirmation,
)
from exceptiondrive_records.splits.tables import ConfirmationRow
from exceptiondrive_schemas.api.confirmation import Confirmation
from exceptiondrive_schemas.protocols.difference import Difference
from exceptiondrive_server.protocols.api import TOML, ProtocolHead, protocol_head
from exceptiondrive_server.web.auth import Organizer, ServicesOf
from exceptiondrive_server.web.forms import Action

router = APIRouter()
MAX_PROTOCOL_CHARACTERS = 200_000
Version = Annotated[str, Path(max_length=100, description="version or digest")]
PhaseQuery = Annotated[str | None, Query(max_length=64, description="only of this phase")]
ConfirmationId = Annotated[str, Path(max_length=64, description="id of a confirmation")]
Toml = Annotated[
    str, Body(media_type="application/toml", min_length=1, max_length=MAX_PROTOCOL_CHARACTERS)
]


class ConfirmationView(BaseModel):
    """A confirmation as it was given."""

    id: str
    confirmation: Confirmation
    confirmed_at: datetime


class KnownProtocol(ProtocolHead):
    """A protocol in the organizers' list."""

    is_draft: bool
    """No phase stands under it, and no board was shown: readers do not know of it."""


@router.get("/protocols", operation_id="listAllProtocols")
def get_all_protocols(services: ServicesOf) -> list[KnownProtocol]:
    """List all protocols, drafts too, oldest first."""
    with services.database.read() as session:
        shown = shown_digests(session)
        return [
            KnownProtocol(
                **protocol_head(protocol).model_dump(), is_draft=protocol.digest not in shown
            )
            for protocol in list_protocols(session)
        ]


@router.get(
    "/protocols/{version}/toml",
    operation_id="showAnyProtocol",
    response_class=Response,
    responses={200: {"content": {TOML: {"schema": {"type": "string"}}}}},
)
def get_any_protocol(services: ServicesOf, version: Version) -> Response:
    """Get the TOML document of a protocol, even of a draft."""
    with services.database.read() as session:
        toml = find_protocol_row(session, version).toml
    return Response(toml, media_type=TOML, headers={"Cache-Control": "no-store"})


@router.post("/protocols/{version}/delete", operation_id="deleteProtocol")
def post_deletion(
    services: ServicesOf, organizer: Organizer, version: Version, action: Action
) -> ProtocolHead:
    """Delete a protocol that no phase, run, board or sheet ever used."""
    with services.database.write() as session:
        gone = delete_protocol(session, version, reason=action.reason, actor=organizer.actor)
    return protocol_head(gone)


@router.post("/protocols/check", operation_id="checkProtocol")
def post_protocol_check(services: ServicesOf, toml: Toml, phase: PhaseQuery = None) -> Difference:
    """Validate a protocol document and describe what it changes, without storing it."""
    with services.database.read() as session:
        return protocol_check(session, toml, phase)


@router.post(
    "/protocols",
    operation_id="addProtocol",
    status_code=201,
    responses={200: {"model": ProtocolHead, "description": "This very document is there already."}},
)
def post_protocol(
    response: Response, services: ServicesOf, organizer: Organizer, toml: Toml
) -> ProtocolHead:
    """Add a protocol document; it is immutable from then on."""
    with services.database.write() as session:
        n_before = len(list_protocols(session))
        added = add_protocol(session, toml, organizer.actor)
        if len(list_protocols(session)) == n_before:
            response.status_code = 200
    return protocol_head(added)


@router.get("/confirmations", operation_id="listConfirmations")
def get_confirmations(services: ServicesOf) -> list[ConfirmationView]:
    """List signed confirmations, newest first; workers decide which keys count."""
    with services.database.read() as session:
        return [_confirmation(row) for row in list_confirmations(session)]


@router.post("/confirmations", operation_id="confirmProtocol", status_code=201)
def post_confirmation(
    services: ServicesOf, organizer: Organizer, given: Confirmation
) -> ConfirmationView:
    """Store an organizer's signed confirmation that a split revision may be scored under a protocol."""
    with services.database.write() as session:
        return _confirmation(add_confirmation(session, given, organizer.actor))


@router.post("/confirmations/{confirmation_id}/withdraw", operation_id="withdrawConfirmation")
def post_withdrawal(
    services: ServicesOf, organizer: Organizer, confirmation_id: ConfirmationId, action: Action
) -> list[ConfirmationView]:
    """Withdraw a confirmation; return the remaining ones."""
    with services.database.write() as session:
        withdraw_confirmation(session, confirmation_id, action.reason, organizer.actor)
    return get_confirmations(services)


def _confirmation(row: ConfirmationRow) -> ConfirmationView:
    return ConfirmationView(id=row.id, confirmation=row.confirmation, confirmed_at=row.confirmed_at)
