"""A team's questions to the organizers, and their answers."""

from urllib.parse import urlencode

from fastapi import APIRouter
from fastapi.responses import RedirectResponse, Response

from exceptiondrive_records.accounts.sessions import require_unrevoked
from exceptiondrive_records.accounts.tokens import Scope
from exceptiondrive_records.db.errors import NotFound, RecordsError
from exceptiondrive_records.news.questions import MAX_QUESTION, ask_question, questions_of
from exceptiondrive_records.phases.phases import shown_phase
from exceptiondrive_server.news.views import question_view
from exceptiondrive_server.web.auth import team_of
from exceptiondrive_server.web.browser_session import Browser, PostedForm, SignedIn, require_scope
from exceptiondrive_server.web.path_ids import PhaseId
from exceptiondrive_server.web.responses import my_page

router = APIRouter(include_in_schema=False)


@router.get("/my/questions/{phase_id}")
def show_questions(browser: Browser, phase_id: PhaseId) -> Response:
    """Show what the team asked about a phase, and the form; an organizer is led to all questions."""
    if browser.principal.role is not None:
        address = f"/organize/news?{urlencode({'phase': phase_id})}"
        return RedirectResponse(address, status_code=303)
    return _questions(browser, phase_id)


@router.post("/my/questions/{phase_id}")
def post_question(browser: Browser, form: PostedForm, phase_id: PhaseId) -> Response:
    """Ask; a refusal shows the form again with what was typed."""
    require_scope(browser, Scope.SUBMIT)
    who, text = browser.principal, str(form.get("text", ""))
    try:
        with browser.services.database.write() as session:
            require_unrevoked(session, who)
            ask_question(session, team_of(who), phase_id, text, actor=who.actor)
    except NotFound:
        raise
    except RecordsError as refusal:
        return _questions(browser, phase_id, text, refusal)
    return RedirectResponse(f"/my/questions/{phase_id}", status_code=303)


def _questions(
    browser: SignedIn, phase_id: str, text: str = "", refusal: RecordsError | None = None
) -> Response:
    require_scope(browser, Scope.READ_OWN)
    with browser.services.database.read() as session:
        phase = shown_phase(session, phase_id)
        asked = questions_of(session, team_of(browser.principal), phase.id)
        questions = [question_view(row) for row in asked]
    return my_page(
        browser,
        "news/questions.html",
        phase=phase,
        questions=questions,
        text=text,
        refusal=refusal,
        max_length=MAX_QUESTION,
        can_ask=Scope.SUBMIT in browser.principal.scopes,
    )
