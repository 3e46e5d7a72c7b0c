"""Protocols: list, check against every phase, add, delete; confirmations of organizers."""

from functools import partial
from typing import Annotated, Any

from fastapi import APIRouter, Path, Query
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import Response
from pydantic import ValidationError
from sqlalchemy.orm import Session
from starlette.datastructures import FormData, UploadFile

from exceptiondrive_records.db.errors import InvalidRecord, RecordsError
from exceptiondrive_records.phases.phases import list_phases
from exceptiondrive_records.protocols.protocols import (
    add_protocol,
    checked_protocol,
    delete_protocol,
    find_protocol,
    find_protocol_row,
    list_protocol_rows,
    protocol_users,
)
from exceptiondrive_records.protocols.shown import shown_digests
from exceptiondrive_records.rescoring.views import protocol_check
from exceptiondrive_records.splits.confirmations import (
    add_confirmation,
    list_confirmations,
    withdraw_confirmation,
)
from exceptiondrive_schemas.api.confirmation import Confirmation
from exceptiondrive_schemas.api.form_fields import FormField
from exceptiondrive_server.protocols.organizer_api import MAX_PROTOCOL_CHARACTERS, get_any_protocol
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.browser_session import (
    FORM_TOKEN,
    SignedIn,
    require_form_token,
    require_same_origin,
)
from exceptiondrive_server.web.forms import REASON
from exceptiondrive_server.web.organizer_frame import (
    OrganizerBrowser,
    Step,
    go,
    organizer_page,
    step_at,
)

router = APIRouter(prefix="/organize/protocols", include_in_schema=False)
HERE = "/organize/protocols"
MAX_FIELDS = 8
ConfirmationId = Annotated[str, Path(max_length=64)]
Version = Annotated[str, Path(max_length=100)]


@router.get("")
def show_protocols(browser: OrganizerBrowser) -> Response:
    """List the protocols, newest first, and the phases that show each."""
    with browser.services.database.read() as session:
        rows = list_protocol_rows(session)[::-1]
        protocols = {row.digest: find_protocol(session, row.digest) for row in rows}
        phases = list_phases(session, with_hidden=True)
        confirmations = list_confirmations(session)
        shown, users = shown_digests(session), protocol_users(session)
        start = _starting_versions(session)[:1]
    return organizer_page(
        browser,
        "protocols/organizer_protocols.html",
        "protocols",
        rows=rows,
        protocols=protocols,
        phases=phases,
        shown=shown,
        users=users,
        start=start,
        confirmations=confirmations,
    )


@step_at(router, "/confirm")
def confirmation() -> Step:
    """Keep what an organizer signed on a machine of their own."""
    return _step(
        title="Confirm a protocol on a split",
        meaning="If a withheld split requires a second organizer, two sign that it may be scored under "
        "a protocol, each with a key that is on no server. Sign on your own machine, with the document "
        "that you read there.",
        button="Store the confirmation",
        fields=(
            FormField("confirmation", "Output of the command", "lines", "JSON", is_required=True,
                  max_length=2000),
        ),
        command="exceptiondrive organizer protocols confirm new.toml --split NAME "
        "--revision REVISION",
        take=_add_confirmation,
        done="protocol_confirmed",
    )  # fmt: skip


def _add_confirmation(session: Session, *, confirmation: str, actor: str) -> None:
    try:
        given = Confirmation.read(confirmation.encode())
    except ValidationError:
        raise InvalidRecord(
            "This is not a confirmation: paste everything that the command wrote."
        ) from None
    add_confirmation(session, given, actor)


@step_at(router, "/confirmations/{confirmation_id}/withdraw")
def withdrawal(confirmation_id: ConfirmationId) -> Step:
    """Take a confirmation back."""
    return _step(
        title="Withdraw the confirmation",
        meaning="If the split requires a second organizer, workers score nothing more and build "
        "no board under this protocol until it is confirmed again. What is published stays.",
        button="Withdraw",
        fields=(REASON,),
        command=f"exceptiondrive organizer protocols withdraw-confirmation {confirmation_id} "
        '--reason "…"',
        is_grave=True,
        take=partial(withdraw_confirmation, confirmation_id=confirmation_id),
        done="confirmation_withdrawn",
    )


@router.get("/new")
def show_new(
    browser: OrganizerBrowser, start: Annotated[str, Query(max_length=100)] = ""
) -> Response:
    """Show the form, empty or with the text of a protocol to start from."""
    with browser.services.database.read() as session:
        toml = find_protocol_row(session, start).toml if start else ""
    return _form(browser, toml)


@router.post("/new")
async def post_new(browser: OrganizerBrowser) -> Response:
    """Check a document and say what it changes, or add it; what was typed stays.

    It comes in the text field, or as a file, which replaces that.
    """
    require_same_origin(browser.request)
    async with browser.request.form(
        max_files=1, max_fields=MAX_FIELDS, max_part_size=4 * MAX_PROTOCOL_CHARACTERS
    ) as form:
        require_form_token(browser.form_token, str(form.get(FORM_TOKEN, "")))
        shall_add = form.get("do") == "add"
        try:
            toml = _checked_text(await _posted_text(form))
        except InvalidRecord as fault:
            typed = str(form.get("toml", ""))
            return await run_in_threadpool(_form, browser, typed, fault)
    return await run_in_threadpool(_answer, browser, toml, shall_add)


@router.get("/{version}/toml")
def show_toml(browser: OrganizerBrowser, version: Version) -> Response:
    """Give the document of a protocol, of a draft too."""
    return get_any_protocol(browser.services, version)


@step_at(router, "/{version}/delete")
def deletion(services: ServicesOf, version: Version) -> Step:
    """Delete a protocol that nothing uses."""
    with services.database.read() as session:
        protocol = find_protocol(session, version)
    return _step(
        title=f"Delete protocol {protocol.version}",
        meaning="Only a protocol that no phase, run, board or sheet uses can be deleted. The audit log "
        "keeps its digest.",
        button="Delete the protocol",
        fields=(REASON,),
        facts=(("Title", protocol.title), ("What changes", protocol.changes)),
        command=f'exceptiondrive organizer protocols delete {protocol.version} --reason "…"',
        is_grave=True,
        take=partial(delete_protocol, version_or_digest=version),
        done="protocol_deleted",
    )


def _step(**words: Any) -> Step:
    return Step(section="protocols", back=HERE, back_words="Protocols", **words)


async def _posted_text(form: FormData) -> str:
    file = form.get("file")
    if not isinstance(file, UploadFile) or not file.size:
        return str(form.get("toml", ""))
    try:
        return (await file.read()).decode()
    except UnicodeDecodeError:
        raise InvalidRecord("The file is not UTF-8 text; nothing was read from it.") from None


def _checked_text(toml: str) -> str:
    """Browsers end lines with CR LF; the document is kept as it was written."""
    toml = toml.replace("\r\n", "\n").removeprefix("\ufeff")
    if len(toml) > MAX_PROTOCOL_CHARACTERS:
        raise InvalidRecord(f"The document is longer than {MAX_PROTOCOL_CHARACTERS} characters.")
    if not toml.strip():
        raise InvalidRecord("There is no document: paste one, or choose a file.")
    return toml


def _answer(browser: SignedIn, toml: str, shall_add: bool) -> Response:
    try:
        if shall_add:
            with browser.services.database.write() as session:
                known = {row.digest for row in list_protocol_rows(session)}
                added = add_protocol(session, toml, browser.principal.actor)
            return go(HERE, "protocol_known" if added.digest in known else "protocol_added")
        with browser.services.database.read() as session:
            verdict = _verdict(session, toml)
    except RecordsError as refusal:
        return _form(browser, toml, refusal)
    return _form(browser, toml, verdict=verdict)


def _verdict(session: Session, toml: str) -> dict[str, Any]:
    """Return what a valid document would change; of each phase its id, its version now, and the difference."""
    protocol = checked_protocol(session, toml)
    return {
        "version": protocol.version,
        "is_known": protocol.digest in {row.digest for row in list_protocol_rows(session)},
        "phases": [
            (
                phase.id,
                find_protocol(session, phase.protocol_digest).version,
                protocol_check(session, toml, phase.id),
            )
            for phase in list_phases(session, with_hidden=True)
        ],
    }


def _starting_versions(session: Session) -> list[str]:
    """Return the versions to start a new document from: first what phases stand under, then drafts."""
    in_force = {phase.protocol_digest for phase in list_phases(session, with_hidden=True)}
    newest_first = reversed(list_protocol_rows(session))
    ordered = sorted(newest_first, key=lambda row: row.digest not in in_force)
    return [row.version for row in ordered]


def _form(
    browser: SignedIn,
    toml: str,
    refusal: RecordsError | None = None,
    verdict: dict[str, Any] | None = None,
) -> Response:
    """Show the form; each line of a refusal but its head is a problem."""
    with browser.services.database.read() as session:
        starts = _starting_versions(session)
    lines = [] if refusal is None else str(refusal).splitlines()
    return organizer_page(
        browser,
        "protocols/organizer_new.html",
        "protocols",
        refusal=refusal,
        toml=toml,
        starts=starts,
        problems=lines[1:] or lines,
        verdict=verdict,
    )
