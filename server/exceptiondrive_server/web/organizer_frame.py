"""Around every page of the organizers: who may see it, and what all of them carry."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Annotated, Any

from fastapi import Depends, Request
from fastapi.responses import RedirectResponse, Response

from exceptiondrive_records.accounts.tokens import Scope
from exceptiondrive_records.db.errors import RecordsError
from exceptiondrive_schemas.form_fields import FormField
from exceptiondrive_schemas.printable import counted
from exceptiondrive_server.accounts.browser_session import Browser, SignedIn, require_scope
from exceptiondrive_server.web.forms import filled
from exceptiondrive_server.web.problem_vocabulary import STATUS_OF
from exceptiondrive_server.web.responses import private_page

# What was just done, in words: addresses carry a key, never a text of their own.


DONE: Mapping[str, str] = MappingProxyType(
    {
        "team_created": "The team is created. Issue its first token below, and hand it over.",
        "team_approved": "The team is approved: it may submit.",
        "team_refused": "The registration is refused. The team and its tokens are gone.",
        "token_revoked": "The token is revoked. It no longer works.",
        "phase_created": "The phase is created.",
        "phase_changed": "The phase is changed; the audit log says from what to what.",
        "submission_retried": "The submission is queued again, with all its attempts.",
        "protocol_added": "The protocol is added. No score changes until you rescore with it.",
        "protocol_known": "This very document is there already. Nothing was added.",
        "run_drafted": "The run is drafted. Nothing is scored until you start it.",
        "run_started": "Scoring has begun, behind fresh submissions.",
        "run_paused": "The run is paused: no further sheet begins.",
        "run_resumed": "The run goes on, and failed sheets are tried again.",
        "run_cancelled": "The run is cancelled. The public board never changed.",
        "run_applied": "Applied: readers see the new board from now on.",
        "run_rolled_back": "Rolled back: readers see the earlier protocol's board again.",
        "run_closed": "The run is closed: the new protocol stays.",
        "verification_started": "Workers recompute the sheets from their uploads.",
    }
)


SECTIONS = (
    ("overview", "Overview", "/organize"),
    ("teams", "Teams", "/organize/teams"),
    ("phases", "Phases", "/organize/phases"),
    ("submissions", "Submissions", "/organize/submissions"),
    ("protocols", "Protocols", "/organize/protocols"),
    ("rescoring", "Rescoring", "/organize/rescoring"),
    ("audit", "Audit log", "/organize/audit"),
)
NO_STORE = {"Cache-Control": "no-store"}


def organizing(browser: Browser) -> SignedIn:
    """Return the organizer who signed in.

    Raises:
        SignInNeeded: Nobody did.
        ApiProblem: The token of the session is not an organizer's: 403, as the API answers.
    """
    require_scope(browser, Scope.ORGANIZE)
    return browser


OrganizerBrowser = Annotated[SignedIn, Depends(organizing)]


@dataclass(frozen=True)
class Frame:
    """What every template of the organizers needs besides its subject."""

    section: str
    organizer: str
    form_token: str
    done: str | None
    """What was just done, in words."""
    sections: tuple[tuple[str, str, str], ...] = SECTIONS


def organizer_page(
    request: Request,
    browser: SignedIn,
    template: str,
    section: str,
    *,
    status: int = 200,
    **values: Any,
) -> Response:
    """Fill a template of the organizers; nothing may keep the answer."""
    frame = Frame(
        section=section,
        organizer=browser.principal.person_name or browser.principal.token_name,
        form_token=browser.form_token,
        done=DONE.get(request.query_params.get("done", "")),
    )
    name = template
    return private_page(request, name, "organize", status=status, frame=frame, **values)


def go(path: str, done: str | None = None) -> Response:
    """Lead the browser on; `done` is a key of `DONE`, which the next page says in words."""
    address = path if done is None else f"{path}?done={done}"
    return RedirectResponse(address, status_code=303, headers=NO_STORE)


def status_of(error: RecordsError) -> int:
    """Return the HTTP status that the API gives to a refusal."""
    return STATUS_OF[error.code]


# Lengths of time in words.


def duration_words(seconds: float) -> str:
    """Write a length of time in its largest unit: `12 s`, `5 minutes`, `3 hours`, `2 days`."""
    if seconds < 90:
        return f"{max(0, round(seconds))} s"
    if seconds < 90 * 60:
        return counted(round(seconds / 60), "minute")
    if seconds < 36 * 3600:
        return counted(round(seconds / 3600), "hour")
    return counted(round(seconds / 86400), "day")


# A step that is confirmed on a page of its own: what it does, a reason, one button.


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
        "web/organizer_step.html",
        step.section,
        status=200 if refusal is None else status_of(refusal),
        step=step,
        fields=filled(step.fields, texts or {}),
        refusal=None if refusal is None else str(refusal),
    )
