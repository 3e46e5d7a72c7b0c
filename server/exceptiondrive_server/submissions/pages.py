"""Pages of submissions: how to submit, the upload form, a team's list, one submission.

All of them work without scripts. Another team's submission answers 404.
"""

import dataclasses
import time
from collections.abc import Mapping
from functools import partial
from typing import Annotated, Literal
from urllib.parse import urlencode

from fastapi import APIRouter, Query, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.exceptions import RequestValidationError
from fastapi.responses import RedirectResponse, Response
from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.tokens import Principal, Scope
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import NotConfirmed, RecordsError
from exceptiondrive_records.entries.selection import choose, publish, unpublish
from exceptiondrive_records.notifications.inbox import (
    count_unread,
    list_notifications,
    notices_about,
)
from exceptiondrive_records.phases.phases import find_phase, list_phases, phase_view
from exceptiondrive_records.phases.policy import can_change, can_publish
from exceptiondrive_records.submissions.edits import edits_of
from exceptiondrive_records.submissions.submissions import (
    find_submission,
    submission_page,
    withdraw,
)
from exceptiondrive_records.submissions.views import view, views
from exceptiondrive_schemas.api.phase_settings import RunRule
from exceptiondrive_schemas.api.submission import PhaseView, SubmissionStatus, SubmissionView
from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_schemas.published import DOCUMENT_NAMES, example_text
from exceptiondrive_server.boards.page import PhaseLink
from exceptiondrive_server.boards.queries import featured_protocol, phase_link
from exceptiondrive_server.guide.client_files import client_wheel
from exceptiondrive_server.submissions.decisions import confirmed_upload, decide
from exceptiondrive_server.submissions.download import attachment
from exceptiondrive_server.submissions.events import follow_submission
from exceptiondrive_server.submissions.facts_form import FACT_FIELDS
from exceptiondrive_server.submissions.profile import asked_for_profile
from exceptiondrive_server.submissions.queries import phase_rules, score_tables
from exceptiondrive_server.submissions.quick_start import quick_start
from exceptiondrive_server.submissions.receipts_api import get_receipt
from exceptiondrive_server.submissions.runs import run_lines
from exceptiondrive_server.submissions.upload import received_upload, take_upload
from exceptiondrive_server.submissions.view import actions_of, policy_sentences, status_of, steps_of
from exceptiondrive_server.web.auth import own_team
from exceptiondrive_server.web.browser_session import (
    Browser,
    Elsewhere,
    MaybeSignedIn,
    PostedForm,
    SignedIn,
    require_same_origin,
    require_scope,
)
from exceptiondrive_server.web.forms import NOTHING_KEPT, filled_fields, posted_texts
from exceptiondrive_server.web.path_ids import SubmissionId
from exceptiondrive_server.web.problem_vocabulary import PROBLEMS, ApiProblem
from exceptiondrive_server.web.problems import problem_of, wants_page
from exceptiondrive_server.web.responses import my_page, origin_of, page, private_page
from exceptiondrive_server.web.services import Services, services_of

router = APIRouter(include_in_schema=False)
SHOWN = 50
SHOWN_NOTICES = 2
"""Of those that are new; the rest is counted."""
MAX_FOLLOWED = 3
"""Browsers open six connections to a host over HTTP/1.1; the page needs some for itself."""
_DECISIONS = {"publish": publish, "unpublish": unpublish}


@router.get("/submit")
def show_submit(
    request: Request,
    browser: MaybeSignedIn,
    phase: str | None = None,
    sent: Annotated[str | None, Query(max_length=64)] = None,
) -> Response:
    """Show how to submit; to a team that may, the form too.

    `sent` is the submission that a session has sent or changed which may not see it.
    """
    return _submit_page(request, browser, phase, sent=sent)


@router.post("/submit")
async def submit(browser: Browser) -> Response:
    """Take an upload as the API does, and lead to the page of the submission."""
    began_s = time.monotonic()
    require_same_origin(browser.request)
    require_scope(browser, Scope.SUBMIT)
    who = browser.principal
    try:
        async with received_upload(
            browser.request, browser.services, who, form_token=browser.form_token
        ) as upload:
            taken, _ = await run_in_threadpool(take_upload, browser.services, who, upload, began_s)
    except (RecordsError, RequestValidationError) as error:
        if not wants_page(browser.request):
            raise
        problem = problem_of(error)
        form = posted_texts(await browser.request.form())
        return await run_in_threadpool(
            _submit_page, browser.request, browser, form.get("phase"), form, problem
        )
    address = f"/submissions/{taken.id}" + ("?again=1" if taken.is_duplicate else "")
    return RedirectResponse(address, status_code=303)


def _submit_page(
    request: Request,
    browser: SignedIn | None,
    wanted: str | None,
    texts: Mapping[str, str] = NOTHING_KEPT,
    refusal: ApiProblem | None = None,
    sent: str | None = None,
) -> Response:
    """Show the quick start for a phase, and the form again with what was typed before a refusal."""
    services = services_of(request)
    with services.database.read() as session:
        links = tuple(phase_link(session, phase) for phase in list_phases(session))
        protocol = featured_protocol(session)
        phases = _phases(session, services, None if browser is None else browser.principal)
        if phases:
            links = tuple(map(_as_to_team, links, phases))
        standing = () if browser is None else _standing_runs(session, browser.principal)
        if browser is not None and sent is not None:
            find_submission(session, sent, team_id=own_team(browser.principal))
    phase = _chosen_phase(links, wanted)
    challenge = phase.challenge if phase else next(iter(CHALLENGES.values()))
    code = challenge.words.code
    team = None if browser is None else browser.principal.team_name
    upload = None
    if browser is not None and team is not None and _may_submit(browser.principal):
        open_phases = _to_submit_to(phases)
        ids = {one.id for one in open_phases}
        stand = [one for one in standing if one.phase in ids]
        upload = {
            "team": team,
            "phases": open_phases,
            "standing": [one for one in stand if one.is_published and not one.disqualified_at],
            "counterparts": [one for one in stand if _may_be_linked(one)],
            "wanted": wanted,
            "sent": sent,
            "sees_own": Scope.READ_OWN in browser.principal.scopes,
            "form_token": browser.form_token,
            "typed": texts,
            "facts": filled_fields(FACT_FIELDS, texts),
            "refusal": refusal,
            "title": "" if refusal is None else PROBLEMS[refusal.code].title,
        }
    wheel = client_wheel(services)
    answer = (page if browser is None else private_page)(
        request,
        "submissions/submit.html",
        "submit",
        status=200 if refusal is None else PROBLEMS[refusal.code].status,
        phases=links,
        phase=phase,
        asked=next((link for link in links if link.id == wanted and link is not phase), None),
        challenge=challenge,
        one_of_each=_one_phase_each(links),
        protocol=protocol,
        formats={key: CHALLENGES[key] for key in CHALLENGES if key in DOCUMENT_NAMES},
        example_text=example_text,
        blocks=quick_start(
            origin_of(request), phase, _development_phase(links, phase), code, wheel
        ),
        has_client=wheel is not None,
        development=_development_phase(links, phase),
        upload=upload,
        who=None if browser is None else browser.principal,
        CHALLENGES=CHALLENGES,
    )
    if refusal is not None and refusal.retry_after_s is not None:
        answer.headers["Retry-After"] = str(refusal.retry_after_s)
    return answer


def _may_submit(who: Principal) -> bool:
    return Scope.SUBMIT in who.scopes and not who.team_is_pending


def _may_be_linked(one: SubmissionView) -> bool:
    has_reminders = one.sheet is not None and one.sheet.has_reminders
    return CHALLENGES[one.challenge].counterpart is not None and not has_reminders


def _only_submits(who: Principal) -> bool:
    return Scope.SUBMIT in who.scopes and Scope.READ_OWN not in who.scopes


def _standing_runs(session: Session, who: Principal) -> tuple[SubmissionView, ...]:
    """Return the team's scored runs that no other one replaces, as far as it may see them."""
    if who.team_id is None or Scope.READ_OWN not in who.scopes:
        return ()
    scored, _ = submission_page(
        session, team_id=who.team_id, status=SubmissionStatus.SCORED, limit=SHOWN
    )
    return tuple(each for each in views(session, scored) if each.replaced_by is None)


def _chosen_phase(phases: tuple[PhaseLink, ...], wanted: str | None) -> PhaseLink | None:
    """Return the phase named, if it takes files or will, else the first open one."""
    named = [p for p in phases if p.id == wanted and (p.takes_files or p.is_ahead)]
    return next(iter([*named, *(phase for phase in phases if phase.is_open)]), None)


def _development_phase(phases: tuple[PhaseLink, ...], chosen: PhaseLink | None) -> PhaseLink | None:
    """The chosen phase if its split is public, else another one of its challenge that has such a split."""
    if chosen is None:
        return None
    public = [one for one in phases if one.split_is_public and one.challenge == chosen.challenge]
    return chosen if chosen.split_is_public else next(iter(public), None)


def _as_to_team(link: PhaseLink, seen: PhaseView) -> PhaseLink:
    """What is said of a phase to a team, which may have a later deadline of its own."""
    closes_at = seen.own_closes_at or seen.closes_at
    return dataclasses.replace(
        link, is_open=seen.is_open, takes_late=seen.takes_late_entries, closes_at=closes_at
    )


def _one_phase_each(phases: tuple[PhaseLink, ...]) -> list[PhaseLink]:
    """The first open phase of each challenge; none where there is no choice."""
    first = {phase.challenge.id: phase for phase in reversed(phases) if phase.is_open}
    return [first[key] for key in CHALLENGES if key in first] if len(first) > 1 else []


def _to_submit_to(phases: tuple[PhaseView, ...]) -> tuple[PhaseView, ...]:
    """Open phases; then closed ones that still rank late entries."""
    late = (phase for phase in phases if phase.takes_late_entries)
    return (*(phase for phase in phases if phase.is_open), *late)


def _phases(session: Session, services: Services, who: Principal | None) -> tuple[PhaseView, ...]:
    """All phases with the quota of who asks; none for somebody without a team."""
    if who is None or who.team_id is None:
        return ()
    limit = services.settings.max_upload_bytes
    return tuple(
        phase_view(session, phase, max_upload_bytes=limit, team_id=who.team_id)
        for phase in list_phases(session)
    )


@router.get("/my")
def show_my_submissions(
    browser: Browser, after: Annotated[str | None, Query(max_length=64)] = None
) -> Response:
    """List the team's submissions, newest first, and what is left of its quotas."""
    if _only_submits(browser.principal):
        return RedirectResponse("/submit", status_code=303)
    require_scope(browser, Scope.READ_OWN)
    who = browser.principal
    if who.phases:
        raise Elsewhere(f"/organize/phases/{min(who.phases)}")
    with browser.services.database.read() as session:
        team_id = own_team(who)
        found, following = submission_page(session, team_id=team_id, after=after, limit=SHOWN)
        seen = views(session, found)
        phases = list_phases(session, with_hidden=True)
        rules = phase_rules(session, phases)
        by_id, now = {phase.id: phase for phase in phases}, database_now(session)
        ended = {one.id for one in found if not can_change(by_id[one.phase_id], one, now)}
        unread, n_unread = [], 0
        if who.team_id is not None:
            unread = list_notifications(session, who.team_id, only_unread=True, limit=SHOWN_NOTICES)
            n_unread = count_unread(session, who.team_id)
        quotas = _to_submit_to(_phases(session, browser.services, who))
    can_decide = Scope.SUBMIT in who.scopes and who.team_id is not None
    lines = run_lines(seen, rules, ended=ended, can_decide=can_decide)
    has_tokens = Scope.TOKENS in who.scopes and who.team_id is not None
    return my_page(
        browser,
        "submissions/my.html",
        lines=lines,
        unread=unread,
        n_unread=n_unread,
        titles={phase.id: phase.title for phase in phases},
        labels=list(dict.fromkeys(cell.label for line in lines for cell in line.cells)),
        quotas=quotas,
        following=following,
        followed=[one.id for one in seen if not one.status.is_terminal][:MAX_FOLLOWED],
        has_tokens=has_tokens,
        has_team_page=who.person_id is not None or has_tokens,
    )


@router.get("/submissions/{submission_id}")
def show_submission(
    browser: Browser, submission_id: SubmissionId, again: bool = False, anew: bool = False
) -> Response:
    """Show where a submission stands: this address stays the same from upload to rank."""
    if _only_submits(browser.principal):
        return RedirectResponse(f"/submit?{urlencode({'sent': submission_id})}", status_code=303)
    return _submission(browser, submission_id, is_again=again, is_anew=anew)


def _submission(
    browser: SignedIn,
    submission_id: str,
    *,
    is_again: bool = False,
    is_anew: bool = False,
    question: NotConfirmed | None = None,
) -> Response:
    """Show a submission; `question` is what is asked before it is published."""
    require_scope(browser, Scope.READ_OWN)
    with browser.services.database.read() as session:
        found = find_submission(session, submission_id, team_id=own_team(browser.principal))
        seen = view(session, found)
        phase = find_phase(session, seen.phase)
        is_own = found.team_id == browser.principal.team_id
        ended = not can_change(phase, found, database_now(session))
        is_publishing = can_publish(session, phase)
        sheet = score_tables(session, seen)
        edits = edits_of(session, seen.id)
        notices = notices_about(session, seen.id)
    seen = asked_for_profile(browser.services, seen)
    without_score = (SubmissionStatus.REJECTED, SubmissionStatus.FAILED, SubmissionStatus.WITHDRAWN)
    return private_page(
        browser.request,
        "submissions/submission.html",
        "my",
        refusal=question,
        one=seen,
        phase_title=phase.title,
        progress=status_of(seen),
        steps=steps_of(seen),
        sentences=list(policy_sentences(seen, phase.policy, has_closed=ended)),
        rejected_per_day=phase.rejected_per_day,
        sheet=sheet,
        notices=notices,
        edits=edits,
        form_token=browser.form_token if Scope.SUBMIT in browser.principal.scopes else None,
        actions=actions_of(seen, phase.policy, has_closed=ended, can_publish=is_publishing)
        if is_own
        else (),
        may_be_linked=_may_be_linked(seen),
        can_withdraw=seen.status not in without_score,
        can_send_again=seen.status in (SubmissionStatus.REJECTED, SubmissionStatus.WITHDRAWN)
        and not (ended or seen.is_asked or seen.confirmed_as or seen.disqualified_at)
        and phase.visibility == "shown",
        is_again=is_again,
        is_anew=is_anew and seen.is_asked,
    )


@router.get("/submissions/{submission_id}/receipt")
def show_receipt(browser: Browser, submission_id: SubmissionId) -> Response:
    """Give the signed receipt as a file, as the API gives it."""
    require_scope(browser, Scope.READ_OWN)
    return Response(
        get_receipt(browser.services, browser.principal, submission_id).model_dump_json(
            indent=2, by_alias=True
        ),
        media_type="application/json",
        headers=attachment(f"exceptiondrive-{submission_id}-receipt.json"),
    )


@router.get("/submissions/{submission_id}/events")
async def follow(browser: Browser, submission_id: SubmissionId) -> Response:
    """Send each change of a submission to the page that shows it."""
    require_scope(browser, Scope.READ_OWN)
    return await follow_submission(browser.services, browser.principal, submission_id)


@router.post("/submissions/{submission_id}/withdraw")
def withdraw_submission(
    browser: Browser, form: PostedForm, submission_id: SubmissionId
) -> Response:
    """Take a submission off the board."""
    require_scope(browser, Scope.SUBMIT)
    decide(browser.services, browser.principal, submission_id, withdraw, by_organizers=True)
    return RedirectResponse(f"/submissions/{submission_id}", status_code=303)


@router.post("/submissions/{submission_id}/confirm")
def confirm_submission(browser: Browser, form: PostedForm, submission_id: SubmissionId) -> Response:
    """Let what the team was asked about count, and lead to what counts in its place."""
    require_scope(browser, Scope.SUBMIT)
    confirmed = confirmed_upload(browser.services, browser.principal, submission_id)
    anew = "?anew=1" if confirmed.is_asked else ""
    return RedirectResponse(f"/submissions/{confirmed.id}{anew}", status_code=303)


@router.post("/submissions/{submission_id}/{what}")
def post_decision(
    browser: Browser,
    form: PostedForm,
    submission_id: SubmissionId,
    what: Literal["choose", "publish", "unpublish"],
    rule: RunRule = "this",
) -> Response:
    """Choose a submission for the board, publish it, or make it private again; then go back."""
    decision = partial(choose, rule=rule) if what == "choose" else _DECISIONS[what]
    require_scope(browser, Scope.SUBMIT)
    replace = what != "publish" or form.get("replace") == "yes"
    try:
        decide(browser.services, browser.principal, submission_id, decision, replace=replace)
    except NotConfirmed as question:
        return _submission(browser, submission_id, question=question)
    back = "/my" if form.get("back") == "my" else f"/submissions/{submission_id}"
    return RedirectResponse(back, status_code=303)
