"""The page where a team edits the description of a submission, with the history of edits."""

from collections.abc import Mapping
from functools import partial

from fastapi import APIRouter
from fastapi.responses import RedirectResponse, Response

from exceptiondrive_records.accounts.tokens import Scope
from exceptiondrive_records.db.errors import NotConfirmed, NotFound, RecordsError
from exceptiondrive_records.phases.phases import find_phase
from exceptiondrive_records.submissions.edits import edit_submission, edits_of
from exceptiondrive_records.submissions.submissions import find_submission
from exceptiondrive_records.submissions.views import view
from exceptiondrive_schemas.api.form_fields import FormField
from exceptiondrive_schemas.method_facts import LABELS, MethodFacts, SubmissionChange, Told
from exceptiondrive_server.submissions.decisions import decide
from exceptiondrive_server.submissions.download import own_upload
from exceptiondrive_server.submissions.facts_form import FACT_FIELDS, facts_of_form, texts_of_facts
from exceptiondrive_server.web.auth import own_team
from exceptiondrive_server.web.browser_session import Browser, PostedForm, SignedIn, require_scope
from exceptiondrive_server.web.forms import filled_fields, posted_texts, read_form
from exceptiondrive_server.web.path_ids import SubmissionId
from exceptiondrive_server.web.responses import my_page
from exceptiondrive_server.web.templating import template_filter

router = APIRouter(include_in_schema=False)
WORDS = (
    FormField("method", "Method", is_required=True, max_length=80),
    FormField("description", "Description", "lines", max_length=2000),
    FormField("paper_url", "Paper", max_length=500),
    FormField("code_url", "Code", max_length=500),
    REPLACE := FormField(
        "replace",
        "Let it replace that entry",
        "yes",
        "all runs of both become one method; a later new name does not part them",
    ),
)


@router.get("/submissions/{submission_id}/edit")
def show_edit(browser: Browser, submission_id: SubmissionId) -> Response:
    """Show what the team says of a submission, to be changed."""
    return _page(browser, submission_id)


@router.post("/submissions/{submission_id}/edit")
def post_edit(browser: Browser, form: PostedForm, submission_id: SubmissionId) -> Response:
    """Change it, and go back to the page of the submission."""
    require_scope(browser, Scope.SUBMIT)
    try:
        change = SubmissionChange(**read_form(WORDS, form), facts=facts_of_form(form))
        edit = partial(edit_submission, change=change)
        who, replace = browser.principal, change.replace
        decide(browser.services, who, submission_id, edit, replace=replace, by_organizers=True)
    except NotFound:
        raise
    except RecordsError as refusal:
        return _page(browser, submission_id, posted_texts(form), refusal)
    return RedirectResponse(f"/submissions/{submission_id}", status_code=303)


@router.get("/submissions/{submission_id}/file")
def download(browser: Browser, submission_id: SubmissionId) -> Response:
    """Give a team its own upload again."""
    require_scope(browser, Scope.READ_OWN)
    return own_upload(browser.request, browser.services, browser.principal, submission_id)


def _page(
    browser: SignedIn,
    submission_id: str,
    texts: Mapping[str, str] | None = None,
    refusal: RecordsError | None = None,
) -> Response:
    require_scope(browser, Scope.SUBMIT)
    with browser.services.database.read() as session:
        found = find_submission(session, submission_id, team_id=own_team(browser.principal))
        seen = view(session, found)
        phase = find_phase(session, seen.phase)
        may_read = Scope.READ_OWN in browser.principal.scopes  # as the API asks
        edits = edits_of(session, seen.id) if may_read else ()
    now = {
        "method": seen.method,
        "description": seen.description,
        "paper_url": seen.links.paper or "",
        "code_url": seen.links.code or "",
        **texts_of_facts(seen.facts),
    }
    if texts is not None:
        now = {**dict.fromkeys(now, ""), **texts}
    return my_page(
        browser,
        "submissions/edit.html",
        one=seen,
        phase_title=phase.title,
        texts=now,
        facts=filled_fields(FACT_FIELDS, now),
        replace=filled_fields([REPLACE], now) if isinstance(refusal, NotConfirmed) else (),
        edits=edits,
        refusal=refusal,
    )


@template_filter
def fact_title(name: str) -> str:
    """Return what a field of an edit is called: `facts.map` is Map."""
    known = MethodFacts.model_fields.get(name.removeprefix("facts."))
    return str(known.title) if known and name.startswith("facts.") else name.capitalize()


@template_filter
def fact_words(name: str, value: Told) -> str:
    """Write the value of a field of an edit."""
    labels = LABELS.get(name.removeprefix("facts."), {})
    if isinstance(value, tuple):
        return ", ".join(labels.get(one, one) for one in value) or "not told"
    if isinstance(value, float):
        return f"{value:.15g}"
    return labels.get(value, value) if value else "not told"
