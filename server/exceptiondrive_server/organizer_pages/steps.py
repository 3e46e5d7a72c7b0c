"""A step that is confirmed on a page of its own: what it does, a reason, one button."""

from collections.abc import Mapping
from dataclasses import dataclass

from fastapi import Request
from fastapi.responses import Response

from exceptiondrive_records.errors import RecordsError
from exceptiondrive_schemas.form_fields import FormField
from exceptiondrive_server.browser_session import SignedIn
from exceptiondrive_server.organizer_pages.forms import filled
from exceptiondrive_server.organizer_pages.frame import organizer_page, status_of


@dataclass(frozen=True)
class Step:
    """What the page of a step says and asks."""

    section: str
    title: str
    meaning: str
    """What happens, in a sentence or two."""
    button: str
    back: str
    back_words: str
    fields: tuple[FormField, ...] = ()
    facts: tuple[tuple[str, str | tuple[str, ...]], ...] = ()
    """Name and words; several lines where there are several."""
    command: str = ""
    """The same in a terminal."""
    is_grave: bool = False
    """Cannot be undone, or is seen by every reader."""
    hidden: tuple[tuple[str, str], ...] = ()
    blockers: tuple[str, ...] = ()
    """Why it would be refused now."""


def step_page(
    request: Request,
    browser: SignedIn,
    step: Step,
    *,
    texts: Mapping[str, str] | None = None,
    refusal: RecordsError | None = None,
) -> Response:
    """Show a step; after a refusal with its sentence, and with what was typed."""
    return organizer_page(
        request,
        browser,
        "step.html",
        step.section,
        status=200 if refusal is None else status_of(refusal),
        step=step,
        fields=filled(step.fields, texts or {}),
        refusal=None if refusal is None else str(refusal),
    )
