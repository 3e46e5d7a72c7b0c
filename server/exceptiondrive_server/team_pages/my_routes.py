"""The team's own submissions: the list, and the page of each. Another team's is not found."""

from typing import Annotated, Literal

from fastapi import APIRouter, Path, Query, Request
from fastapi.responses import RedirectResponse, Response
from sqlalchemy.orm import Session

from exceptiondrive_records.clock import database_now
from exceptiondrive_records.final_entries import choose, publish, unpublish
from exceptiondrive_records.phase_life import has_closed
from exceptiondrive_records.phases import list_phases, phase_view
from exceptiondrive_records.protocols import find_protocol
from exceptiondrive_records.submissions import find_submission, list_submissions, withdraw
from exceptiondrive_records.tokens import Principal, Scope
from exceptiondrive_records.views import view, views
from exceptiondrive_schemas.submission import PhaseView
from exceptiondrive_server.api.events import follow_submission
from exceptiondrive_server.auth import ServicesOf, own_team
from exceptiondrive_server.browser_session import Browser, PostedForm, require_scope
from exceptiondrive_server.pages.responses import private_page
from exceptiondrive_server.services import Services
from exceptiondrive_server.team_pages.my_view import PhaseRules, my_view
from exceptiondrive_server.team_pages.submission_view import submission_view

router = APIRouter(include_in_schema=False)
SHOWN = 50
SubmissionId = Annotated[str, Path(max_length=64)]


@router.get("/my")
def show_my_submissions(
    request: Request,
    services: ServicesOf,
    browser: Browser,
    after: Annotated[str | None, Query(max_length=64)] = None,
) -> Response:
    """List the team's submissions, newest first, and what is left of its quotas."""
    require_scope(browser, Scope.READ_OWN)
    who = browser.principal
    with services.database.read() as session:
        team_id = own_team(who)
        found = list_submissions(session, team_id=team_id, after=after, limit=SHOWN + 1)
        content = my_view(
            who,
            views(session, found[:SHOWN]),
            phases=_phases(session, services, who),
            rules=_rules(session),
            following=found[SHOWN - 1].id if len(found) > SHOWN else None,
            form_token=browser.form_token,
        )
    return private_page(request, "my.html", "my", page=content)


@router.get("/submissions/{submission_id}")
def show_submission(
    request: Request,
    services: ServicesOf,
    browser: Browser,
    submission_id: SubmissionId,
    again: bool = False,
) -> Response:
    """Show where a submission stands: this address stays the same from upload to rank."""
    require_scope(browser, Scope.READ_OWN)
    with services.database.read() as session:
        submission = find_submission(session, submission_id, team_id=own_team(browser.principal))
        seen = view(session, submission)
        phase = next(phase for phase in list_phases(session) if phase.id == seen.phase)
        protocol = find_protocol(session, phase.protocol_digest)
        title, rules = phase.title, _rules(session)[phase.id]
    content = submission_view(
        seen,
        phase_title=title,
        protocol=protocol,
        form_token=browser.form_token if Scope.SUBMIT in browser.principal.scopes else None,
        is_again=again,
        policy=rules.policy,
        has_closed=rules.has_closed,
    )
    return private_page(request, "submission.html", "my", page=content)


@router.get("/submissions/{submission_id}/events")
async def follow(services: ServicesOf, browser: Browser, submission_id: SubmissionId) -> Response:
    """Send each change of a submission to the page that shows it."""
    require_scope(browser, Scope.READ_OWN)
    return await follow_submission(services, browser.principal, submission_id)


@router.post("/submissions/{submission_id}/withdraw")
def withdraw_submission(
    services: ServicesOf, browser: Browser, form: PostedForm, submission_id: SubmissionId
) -> Response:
    """Take a submission off the board."""
    require_scope(browser, Scope.SUBMIT)
    who = browser.principal
    with services.database.write() as session:
        find_submission(session, submission_id, team_id=own_team(who))
        withdraw(session, submission_id, actor=who.actor)
    return RedirectResponse(f"/submissions/{submission_id}", status_code=303)


@router.post("/submissions/{submission_id}/{what}")
def say_of_submission(
    services: ServicesOf,
    browser: Browser,
    form: PostedForm,
    submission_id: SubmissionId,
    what: Literal["choose", "publish", "unpublish"],
) -> Response:
    """Choose a submission for the board, publish it, or make it private again; then go back."""
    require_scope(browser, Scope.SUBMIT)
    who = browser.principal
    with services.database.write() as session:
        find_submission(session, submission_id, team_id=own_team(who))
        _SAYINGS[what](session, submission_id, actor=who.actor)
    back = "/my" if form.get("back") == "my" else f"/submissions/{submission_id}"
    return RedirectResponse(back, status_code=303)


_SAYINGS = {"choose": choose, "publish": publish, "unpublish": unpublish}


def _rules(session: Session) -> dict[str, PhaseRules]:
    now = database_now(session)
    return {
        phase.id: PhaseRules(phase.policy, has_closed(phase, now)) for phase in list_phases(session)
    }


def _phases(session: Session, services: Services, who: Principal) -> tuple[PhaseView, ...]:
    if who.team_id is None:
        return ()
    limit = services.settings.max_upload_bytes
    return tuple(
        phase_view(session, phase, max_upload_bytes=limit, team_id=who.team_id)
        for phase in list_phases(session)
    )
