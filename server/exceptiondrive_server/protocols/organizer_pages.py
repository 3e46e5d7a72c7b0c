"""Protocols: list, check a document against every phase, add it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Annotated

from fastapi import APIRouter, Query, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import Response
from sqlalchemy.orm import Session
from starlette.datastructures import FormData, UploadFile

from exceptiondrive_records.db.errors import InvalidRecord, RecordsError
from exceptiondrive_records.phases.phases import list_phases
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.protocols.protocols import (
    add_protocol,
    checked_protocol,
    find_protocol,
    find_protocol_row,
    list_protocol_rows,
)
from exceptiondrive_records.protocols.tables import ProtocolRow
from exceptiondrive_records.rescoring.views import protocol_check
from exceptiondrive_schemas.protocol import Protocol
from exceptiondrive_schemas.protocol_difference import Difference
from exceptiondrive_server.accounts.browser_session import (
    SignedIn,
    require_form_token,
    require_same_origin,
)
from exceptiondrive_server.protocols.organizer_api import MAX_PROTOCOL_CHARACTERS
from exceptiondrive_server.submissions.upload_form import FORM_TOKEN
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.organizer_frame import (
    OrganizerBrowser,
    go,
    organizer_page,
    status_of,
)
from exceptiondrive_server.web.services import Services

# A protocol document from a browser: from the text field, or from a file that replaces it.


MAX_FIELDS = 8


@dataclass(frozen=True)
class ProtocolUpload:
    """What came, and whether it shall be added or only checked."""

    toml: str
    shall_add: bool
    fault: InvalidRecord | None = None


async def received_protocol(request: Request, browser: SignedIn) -> ProtocolUpload:
    """Return the document that a signed-in browser sent.

    Raises:
        ApiProblem: It comes from another site, or without the token of this session.
    """
    require_same_origin(request)
    async with request.form(
        max_files=1, max_fields=MAX_FIELDS, max_part_size=4 * MAX_PROTOCOL_CHARACTERS
    ) as form:
        require_form_token(browser.secret, str(form.get(FORM_TOKEN, "")))
        shall_add = form.get("do") == "add"
        try:
            return ProtocolUpload(_checked(await _text(form)), shall_add)
        except InvalidRecord as fault:
            return ProtocolUpload(str(form.get("toml", "")), shall_add, fault)


async def _text(form: FormData) -> str:
    file = form.get("file")
    if not isinstance(file, UploadFile) or not file.size:
        return str(form.get("toml", ""))
    try:
        return (await file.read()).decode()
    except UnicodeDecodeError:
        raise InvalidRecord("The file is not UTF-8 text; nothing was read from it.") from None


def _checked(toml: str) -> str:
    """Browsers end lines with CR LF; the document is kept as it was written."""
    toml = toml.replace("\r\n", "\n").removeprefix("\ufeff")
    if len(toml) > MAX_PROTOCOL_CHARACTERS:
        raise InvalidRecord(f"The document is longer than {MAX_PROTOCOL_CHARACTERS} characters.")
    if not toml.strip():
        raise InvalidRecord("There is no document: paste one, or choose a file.")
    return toml


# Protocols as organizers see them: which are there, and what a new document would change.


@dataclass(frozen=True)
class ProtocolLine:
    """One protocol in the list."""

    version: str
    title: str
    changes: str
    digest: str
    added_at: datetime
    phases: tuple[str, ...]
    """Phases that show it now."""


@dataclass(frozen=True)
class PhaseDifference:
    """What a document would change in one phase."""

    phase: str
    from_version: str
    difference: Difference


@dataclass(frozen=True)
class Verdict:
    """What a check came to: problems, or the differences phase by phase."""

    version: str = ""
    problems: tuple[str, ...] = ()
    is_known: bool = False
    """This very document is there already."""
    phases: tuple[PhaseDifference, ...] = ()

    @property
    def is_good(self) -> bool:
        """Whether the document may be added."""
        return not self.problems


@dataclass(frozen=True)
class ProtocolForm:
    """Everything that `protocol_new.html` needs."""

    toml: str
    verdict: Verdict | None
    starts: tuple[str, ...]
    """Versions that a new document may start from."""


def protocol_lines(
    rows: Sequence[ProtocolRow], protocols: Mapping[str, Protocol], phases: Sequence[Phase]
) -> tuple[ProtocolLine, ...]:
    """Return the list, newest first; `protocols` by digest."""
    return tuple(
        ProtocolLine(
            version=row.version,
            title=protocols[row.digest].title,
            changes=protocols[row.digest].changes,
            digest=row.digest,
            added_at=row.created_at,
            phases=tuple(phase.id for phase in phases if phase.protocol_digest == row.digest),
        )
        for row in reversed(rows)
    )


def refused(text: str) -> Verdict:
    """Return the verdict on a document that cannot be used; each line of `text` is a problem."""
    head, *problems = text.splitlines()
    return Verdict(problems=tuple(problems or [head]))


router = APIRouter(prefix="/organize/protocols", include_in_schema=False)
HERE = "/organize/protocols"


@router.get("")
def show_protocols(request: Request, services: ServicesOf, browser: OrganizerBrowser) -> Response:
    """List the protocols, newest first, and the phases that show each."""
    with services.database.read() as session:
        rows = list_protocol_rows(session)
        protocols = {row.digest: find_protocol(session, row.digest) for row in rows}
        lines = protocol_lines(rows, protocols, list_phases(session))
    return organizer_page(
        request, browser, "protocols/organizer_protocols.html", "protocols", lines=lines
    )


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
        request, browser, "protocols/organizer_new.html", "protocols", status=status, page=content
    )
