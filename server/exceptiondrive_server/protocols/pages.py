"""The page of a protocol: its rules in prose, with the values of the document."""

from fastapi import APIRouter, Request
from fastapi.responses import RedirectResponse, Response
from sqlalchemy.orm import Session

from exceptiondrive_records.db.errors import NotFound
from exceptiondrive_records.protocols.shown import shown_protocols
from exceptiondrive_records.splits.drawings import protocol_drawing
from exceptiondrive_records.splits.shown import splits_under
from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_schemas.flags import FLAGS
from exceptiondrive_schemas.protocol import NEWEST, packaged_protocol
from exceptiondrive_schemas.protocols.difference import protocol_difference
from exceptiondrive_schemas.taxonomy import Strategy
from exceptiondrive_server.boards.queries import featured_protocol
from exceptiondrive_server.boards.scene_drawing import scene_drawing
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.browser_session import browser_sees_hidden
from exceptiondrive_server.web.responses import Values, public_page

router = APIRouter(include_in_schema=False)


@router.get("/protocols")
def show_featured_protocol(services: ServicesOf) -> Response:
    """Lead to the protocol of the phase on the front page."""
    with services.database.read() as session:
        version = featured_protocol(session).version
    return RedirectResponse(f"/protocols/{version}", status_code=307)


@router.get("/protocols/{version}")
def show_protocol(request: Request, version: str) -> Response:
    """Show the rules of a protocol; a draft to organizers alone."""

    def read(session: Session) -> Values:
        return _protocol(session, version, with_drafts=browser_sees_hidden(session, request))

    return public_page(request, "protocols/protocol.html", "protocol", read)


def _protocol(session: Session, version: str, *, with_drafts: bool) -> Values:
    versions = shown_protocols(session, with_drafts=with_drafts) or [packaged_protocol(NEWEST)]
    protocol = next((one for one in versions if version in (one.version, one.digest)), None)
    if protocol is None:
        raise NotFound("protocol", version)
    drawing = protocol_drawing(session, protocol)
    place = versions.index(protocol)
    previous = versions[place - 1] if place else None
    caution = protocol.grading.caution
    return {
        "protocol": protocol,
        "versions": versions,
        "challenges": CHALLENGES.values(),
        "scene": scene_drawing(drawing, protocol),
        "strategies": sorted(Strategy, key=lambda strategy: caution[strategy.value]),
        "flags": FLAGS,
        "previous": previous,
        "splits": splits_under(session, protocol.digest),
        "changes": protocol_difference(previous, protocol, 0).sentences if previous else (),
    }
