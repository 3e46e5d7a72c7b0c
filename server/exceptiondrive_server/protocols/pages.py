"""The page of a protocol: its rules in words, with the values of the document."""

from collections.abc import Iterator
from typing import Any, NamedTuple

from fastapi import APIRouter, Request
from fastapi.responses import RedirectResponse, Response
from sqlalchemy.orm import Session

from exceptiondrive_records.db.errors import NotFound
from exceptiondrive_records.protocols.shown import shown_protocols
from exceptiondrive_records.splits.drawings import protocol_drawing
from exceptiondrive_records.splits.shown import splits_under
from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_schemas.flags import FLAGS
from exceptiondrive_schemas.protocol import NEWEST, ProtocolDocument, packaged_protocol
from exceptiondrive_schemas.taxonomy import Strategy
from exceptiondrive_server.boards.queries import featured_protocol
from exceptiondrive_server.boards.scene_drawing import scene_drawing
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.browser_session import browser_sees_hidden
from exceptiondrive_server.web.responses import Values, public_page

router = APIRouter(include_in_schema=False)
_SELF_DESCRIPTION = ("version", "title", "changes")


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
        "changes": protocol_changes(previous, protocol) if previous else (),
    }


class ValueChange(NamedTuple):
    """One value that differs; None where the value is absent."""

    path: str
    before: str | None
    after: str | None


def protocol_changes(before: ProtocolDocument, after: ProtocolDocument) -> tuple[ValueChange, ...]:
    """Return every value that differs, by its dotted path, in the order of the newer document."""
    old, new = dict(_values(_document(before))), dict(_values(_document(after)))
    paths = [*new, *(path for path in old if path not in new)]
    return tuple(
        ValueChange(path, old.get(path), new.get(path))
        for path in paths
        if old.get(path) != new.get(path)
    )


def _document(protocol: ProtocolDocument) -> dict[str, Any]:
    document = protocol.model_dump(mode="json", by_alias=True)
    for name in _SELF_DESCRIPTION:
        document.pop(name)
    for name in ("families", "tasks"):
        document[name] = {item["id"]: item for item in document[name]}
    return document


def _values(value: Any, path: str = "") -> Iterator[tuple[str, str]]:
    """Yield dotted paths and values of a nested document."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _values(inner, f"{path}.{key}" if path else str(key))
    elif isinstance(value, list) and all(isinstance(item, str) for item in value):
        yield path, ", ".join(value)
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            yield from _values(inner, f"{path}[{index}]")
    else:
        yield path, str(value)
