"""Around every page of the organizers: who may see it, and what all of them carry."""

from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import Depends, Request
from fastapi.responses import RedirectResponse, Response

from exceptiondrive_records.errors import RecordsError
from exceptiondrive_records.tokens import Scope
from exceptiondrive_server.browser_session import Browser, SignedIn, require_scope
from exceptiondrive_server.organizer_pages.done_words import DONE
from exceptiondrive_server.pages.responses import private_page
from exceptiondrive_server.problem_vocabulary import STATUS_OF

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
    name = f"organizer/{template}"
    return private_page(request, name, "organize", status=status, frame=frame, **values)


def go(path: str, done: str | None = None) -> Response:
    """Lead the browser on; `done` is a key of `DONE`, which the next page says in words."""
    address = path if done is None else f"{path}?done={done}"
    return RedirectResponse(address, status_code=303, headers=NO_STORE)


def status_of(error: RecordsError) -> int:
    """Return the HTTP status that the API gives to a refusal."""
    return STATUS_OF[error.code]
