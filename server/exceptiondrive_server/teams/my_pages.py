"""The team's own submissions: the list, and the page of each. Another team's is not found."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Annotated, Literal

from fastapi import APIRouter, Path, Query, Request
from fastapi.responses import RedirectResponse, Response
from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.tokens import Principal, Scope
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.entries.selection import choose, publish, unpublish
from exceptiondrive_records.phases.phases import list_phases, phase_view
from exceptiondrive_records.phases.policy import has_closed
from exceptiondrive_records.protocols.protocols import find_protocol
from exceptiondrive_records.submissions.submissions import (
    find_submission,
    list_submissions,
    withdraw,
)
from exceptiondrive_records.submissions.views import view, views
from exceptiondrive_schemas.phase_settings import PhasePolicy
from exceptiondrive_schemas.submission import PhaseView, SubmissionStatus, SubmissionView
from exceptiondrive_server.accounts.browser_session import Browser, PostedForm, require_scope
from exceptiondrive_server.submissions.events import follow_submission
from exceptiondrive_server.submissions.pages import PhaseOption, quota_line
from exceptiondrive_server.submissions.view import Status, actions_of, status_of, submission_view
from exceptiondrive_server.web.auth import ServicesOf, own_team
from exceptiondrive_server.web.responses import private_page
from exceptiondrive_server.web.services import Services

# What the list of a team's submissions shows.


MAX_FOLLOWED = 3
"""Browsers open six connections to a host over HTTP/1.1; the page needs some for itself."""


@dataclass(frozen=True)
class MyLine:
    """One submission in the list."""

    id: str
    method: str
    team: str
    phase: str
    received_at: datetime
    status: Status
    rank: int | None
    standing: str
    """How it stands in the policy of its phase; empty where there is nothing to say."""
    actions: tuple[tuple[str, str], ...]
    """What the team may say of it: end of the address, and words."""


@dataclass(frozen=True)
class PhaseRules:
    """What the list needs to know of the phase of a submission."""

    policy: PhasePolicy
    has_closed: bool


@dataclass(frozen=True)
class MyPage:
    """Everything that `my.html` needs."""

    team: str | None
    token_name: str
    lines: tuple[MyLine, ...]
    quotas: tuple[PhaseOption, ...]
    following: str | None
    followed: tuple[str, ...]
    form_token: str
    has_tokens: bool
    person_name: str
    """Empty when a token signed in."""
    has_team_page: bool

    @property
    def has_sayings(self) -> bool:
        """Whether a phase in the list leaves something for the team to choose or publish."""
        return any(line.standing or line.actions for line in self.lines)


def my_view(
    who: Principal,
    submissions: Sequence[SubmissionView],
    *,
    phases: Sequence[PhaseView],
    rules: Mapping[str, PhaseRules],
    following: str | None,
    form_token: str,
) -> MyPage:
    """Set the list; the newest that still wait are followed."""
    can_say = Scope.SUBMIT in who.scopes and who.team_id is not None
    waiting = [one.id for one in submissions if not one.status.is_terminal]
    return MyPage(
        team=who.team_name,
        token_name=who.token_name,
        lines=tuple(_line(one, rules[one.phase], can_say) for one in submissions),
        quotas=tuple(quota_line(phase) for phase in phases if phase.is_open),
        following=following,
        followed=tuple(waiting[:MAX_FOLLOWED]),
        form_token=form_token,
        has_tokens=Scope.TOKENS in who.scopes and who.team_id is not None,
        person_name=who.person_name,
        has_team_page=who.person_id is not None
        or (Scope.TOKENS in who.scopes and who.team_id is not None),
    )


def _line(one: SubmissionView, rules: PhaseRules, can_say: bool) -> MyLine:
    policy, has_closed = rules.policy, rules.has_closed
    return MyLine(
        id=one.id,
        method=one.method,
        team=one.team,
        phase=one.phase,
        received_at=one.received_at,
        status=status_of(one),
        rank=one.rank,
        standing=", ".join(_standing(one, policy)),
        actions=actions_of(one, policy, has_closed=has_closed) if can_say else (),
    )


def _standing(one: SubmissionView, policy: PhasePolicy) -> Iterator[str]:
    if one.status is not SubmissionStatus.SCORED:
        return
    if one.is_chosen and policy.entries_shown == "chosen":
        yield "chosen"
    if policy.entries_private:
        yield "published" if one.is_published else "private"
    if one.is_late:
        yield "late"


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
    return private_page(request, "teams/my.html", "my", page=content)


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
    return private_page(request, "submissions/submission.html", "my", page=content)


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
