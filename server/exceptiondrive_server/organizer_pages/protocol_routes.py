"""Protocols: list, check a document against every phase, add it."""

from typing import Annotated

from fastapi import APIRouter, Query, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import Response
from sqlalchemy.orm import Session

from exceptiondrive_records.errors import RecordsError
from exceptiondrive_records.phases import list_phases
from exceptiondrive_records.protocols import (
    add_protocol,
    checked_protocol,
    find_protocol,
    find_protocol_row,
    list_protocol_rows,
)
from exceptiondrive_records.rescoring.views import protocol_check
from exceptiondrive_server.auth import ServicesOf
from exceptiondrive_server.browser_session import SignedIn
from exceptiondrive_server.organizer_pages.frame import (
    OrganizerBrowser,
    go,
    organizer_page,
    status_of,
)
from exceptiondrive_server.organizer_pages.protocol_upload import (
    ProtocolUpload,
    received_protocol,
)
from exceptiondrive_server.organizer_pages.protocol_view import (
    PhaseDifference,
    ProtocolForm,
    Verdict,
    protocol_lines,
    refused,
)
from exceptiondrive_server.services import Services

router = APIRouter(prefix="/organize/protocols", include_in_schema=False)
HERE = "/organize/protocols"


@router.get("")
def show_protocols(request: Request, services: ServicesOf, browser: OrganizerBrowser) -> Response:
    """List the protocols, newest first, and the phases that show each."""
    with services.database.read() as session:
        rows = list_protocol_rows(session)
        protocols = {row.digest: find_protocol(session, row.digest) for row in rows}
        lines = protocol_lines(rows, protocols, list_phases(session))
    return organizer_page(request, browser, "protocols.html", "protocols", lines=lines)


@router.get("/new")
def show_new(
    request: Request,
    services: ServicesOf,
    browser: OrganizerBrowser,
    start: Annotated[str, Query(max_length=100)] = "",
) -> Response:
    """Show the form, empty or with the text of a protocol to start from."""
    with services.database.read() as session:
        toml = find_protocol_row(session, start).toml if start else ""
    return _form(request, services, browser, toml, None)


@router.post("/new")
async def post_new(request: Request, services: ServicesOf, browser: OrganizerBrowser) -> Response:
    """Check a document and say what it changes, or add it; what was typed stays."""
    upload = await received_protocol(request, browser)
    return await run_in_threadpool(_answer, request, services, browser, upload)


def _answer(
    request: Request, services: Services, browser: SignedIn, upload: ProtocolUpload
) -> Response:
    if upload.fault is not None:
        verdict = refused(str(upload.fault))
        return _form(request, services, browser, upload.toml, verdict, status=400)
    try:
        if upload.shall_add:
            return _add(services, browser, upload.toml)
        with services.database.read() as session:
            verdict = _verdict(session, upload.toml)
    except RecordsError as error:
        verdict, status = refused(str(error)), status_of(error)
        return _form(request, services, browser, upload.toml, verdict, status=status)
    return _form(request, services, browser, upload.toml, verdict)


def _add(services: Services, browser: SignedIn, toml: str) -> Response:
    with services.database.write() as session:
        n_before = len(list_protocol_rows(session))
        add_protocol(session, toml, browser.principal.actor)
        is_new = len(list_protocol_rows(session)) > n_before
    return go(HERE, "protocol_added" if is_new else "protocol_known")


def _verdict(session: Session, toml: str) -> Verdict:
    protocol = checked_protocol(session, toml)
    known = {row.digest for row in list_protocol_rows(session)}
    return Verdict(
        version=protocol.version,
        is_known=protocol.digest in known,
        phases=tuple(
            PhaseDifference(
                phase=phase.id,
                from_version=find_protocol(session, phase.protocol_digest).version,
                difference=protocol_check(session, toml, phase.id),
            )
            for phase in list_phases(session)
        ),
    )


def _form(
    request: Request,
    services: Services,
    browser: SignedIn,
    toml: str,
    verdict: Verdict | None,
    *,
    status: int = 200,
) -> Response:
    with services.database.read() as session:
        starts = tuple(row.version for row in reversed(list_protocol_rows(session)))
    content = ProtocolForm(toml, verdict, starts)
    return organizer_page(
        request, browser, "protocol_new.html", "protocols", status=status, page=content
    )
