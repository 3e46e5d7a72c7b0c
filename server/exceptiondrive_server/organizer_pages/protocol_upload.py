"""A protocol document from a browser: from the text field, or from a file that replaces it."""

from dataclasses import dataclass

from fastapi import Request
from starlette.datastructures import FormData, UploadFile

from exceptiondrive_records.errors import InvalidRecord
from exceptiondrive_server.api.organizer_protocols import MAX_PROTOCOL_CHARACTERS
from exceptiondrive_server.browser_session import (
    SignedIn,
    require_form_token,
    require_same_origin,
)
from exceptiondrive_server.upload_form import FORM_TOKEN

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
