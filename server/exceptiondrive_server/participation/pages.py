"""The terms of a phase, which a team reads and accepts."""

from fastapi import APIRouter
from fastapi.responses import RedirectResponse, Response

from exceptiondrive_records.accounts.tokens import Scope
from exceptiondrive_records.phases.phases import shown_phase
from exceptiondrive_records.phases.terms import accept_terms, terms_accepted_at, terms_version
from exceptiondrive_server.web.auth import team_of
from exceptiondrive_server.web.browser_session import Browser, PostedForm, require_scope
from exceptiondrive_server.web.path_ids import PhaseId
from exceptiondrive_server.web.responses import my_page

router = APIRouter(include_in_schema=False)


@router.get("/my/terms/{phase_id}")
def show_terms(browser: Browser, phase_id: PhaseId) -> Response:
    """Show the terms of a phase, and whether the team accepted them."""
    require_scope(browser, Scope.SUBMIT, Scope.READ_OWN)
    with browser.services.database.read() as session:
        phase = shown_phase(session, phase_id)
        accepted_at = terms_accepted_at(session, team_of(browser.principal), phase)
        version = terms_version(phase)
    return my_page(
        browser,
        "participation/terms.html",
        phase=phase,
        version=version,
        accepted_at=accepted_at,
        team_name=browser.principal.team_name,
        can_accept=Scope.SUBMIT in browser.principal.scopes,
    )


@router.post("/my/terms/{phase_id}")
def post_terms(browser: Browser, form: PostedForm, phase_id: PhaseId) -> Response:
    """Accept the terms for the team, in the version that the page showed."""
    require_scope(browser, Scope.SUBMIT)
    who = browser.principal
    with browser.services.database.write() as session:
        phase = shown_phase(session, phase_id)
        accept_terms(session, team_of(who), phase, str(form.get("version", "")), actor=who.actor)
    return RedirectResponse(f"/my/terms/{phase_id}", status_code=303)
