"""The people of a team: members, invitations, and the choice of the team to act for."""

from collections.abc import Mapping
from typing import Annotated, Any

from fastapi import APIRouter, Path, Request
from fastapi.responses import RedirectResponse, Response
from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.attempts import count_attempt, registration_keys_of
from exceptiondrive_records.accounts.makers import live_tokens_by_maker
from exceptiondrive_records.accounts.people import (
    accept_invitation,
    add_member,
    find_invitation,
    find_person,
    invite,
    is_member,
    members_of,
    open_invitations,
    removal_of,
    remove_member,
    teams_of,
    withdraw_invitation,
)
from exceptiondrive_records.accounts.sessions import act_for
from exceptiondrive_records.accounts.tables import Person
from exceptiondrive_records.accounts.tokens import Principal, Scope, live_tokens_by_team, may_invite
from exceptiondrive_records.db.errors import InvalidRecord, RecordsError
from exceptiondrive_records.notifications.contacts import list_contacts
from exceptiondrive_records.submissions.submissions import counts_by_team
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.teams.teams import make_pending_team, self_registration_is_on
from exceptiondrive_schemas.api.form_fields import FormField
from exceptiondrive_schemas.api.problems import ProblemCode
from exceptiondrive_server.web.auth import ServicesOf, address_of, team_of
from exceptiondrive_server.web.browser_session import (
    Browser,
    MaybeSignedIn,
    PostedForm,
    SignedIn,
    keep_session,
    require_scope,
)
from exceptiondrive_server.web.forms import NOTHING_KEPT, filled_fields, posted_texts, read_form
from exceptiondrive_server.web.problem_vocabulary import ApiProblem
from exceptiondrive_server.web.responses import my_page, origin_of, private_page
from exceptiondrive_server.web.services import Services

router = APIRouter(include_in_schema=False)
Id = Annotated[str, Path(max_length=64)]
LinkText = Annotated[str, Path(max_length=200)]
_BACK = "/my/team"
REGISTRATION = (
    FormField("name", "Name", hint="as the board shows it", is_required=True, max_length=80),
    FormField(
        "id",
        "Short id",
        hint="lower-case letters, digits, hyphens",
        is_required=True,
        max_length=64,
    ),
    FormField("note", "Who you are", "lines", "for organizers alone", True, max_length=500),
)


@router.get("/my/team")
def show_team(browser: Browser) -> Response:
    """Show who belongs to the team; to somebody without one, how to get one."""
    return _page(browser)


@router.post("/my/team/act-for")
def choose_team(browser: Browser, form: PostedForm) -> Response:
    """Let the signed-in person act for another of their teams, or as an organizer."""
    person_id = _person_of(browser)
    text = str(form.get("team", ""))
    if text and not (text.isascii() and text.isdigit() and len(text) < 10):
        raise InvalidRecord("There is no such team to act for.")
    with browser.services.database.write() as session:
        act_for(session, browser.secret, person_id, int(text) if text else None)
        is_organizer = not text and find_person(session, person_id).is_organizer
    answer = RedirectResponse("/organize" if is_organizer else "/my", status_code=303)
    keep_session(browser.request, answer, browser.secret, is_organizer=is_organizer)
    return answer


@router.post("/my/team/invitations")
def make_invitation(browser: Browser, form: PostedForm) -> Response:
    """Make an invitation and show its link, once."""
    who = browser.principal
    require_scope(browser, Scope.TOKENS)
    team_id = team_of(who)
    if not may_invite(who):
        detail = "To invite takes a token with all scopes of a team that does not end: who joins gets both."
        raise ApiProblem(ProblemCode.NOT_ALLOWED, detail)
    invited_by = who.person_name or f'the token "{who.token_name}"'
    with browser.services.database.write() as session:
        text, _ = invite(session, team_id, invited_by, actor=who.actor)
    return _page(browser, link=f"{origin_of(browser.request)}/join/{text}")


@router.post("/my/team/invitations/{invitation_id}/withdraw")
def withdraw(browser: Browser, form: PostedForm, invitation_id: Id) -> Response:
    """Make an invitation useless."""
    require_scope(browser, Scope.TOKENS)
    who = browser.principal
    with browser.services.database.write() as session:
        withdraw_invitation(session, team_of(who), invitation_id, actor=who.actor)
    return RedirectResponse(_BACK, status_code=303)


@router.post("/my/team/members/{person_id}/remove")
def remove(browser: Browser, form: PostedForm, person_id: Id) -> Response:
    """Take somebody out of the team, oneself included."""
    require_scope(browser, Scope.TOKENS)
    who = browser.principal
    with browser.services.database.write() as session:
        remove_member(session, team_of(who), person_id, actor=who.actor)
    return RedirectResponse(_BACK, status_code=303)


@router.post("/my/team/register")
def register(browser: Browser, form: PostedForm) -> Response:
    """Register a team for the signed-in person; it submits when an organizer approves."""
    person_id, actor = _person_of(browser), browser.principal.actor
    if not _may_register(browser.services):
        raise ApiProblem(ProblemCode.NOT_ALLOWED, "Teams do not register themselves here.")
    address = address_of(browser.request)
    with browser.services.database.write() as session:
        count_attempt(session, registration_keys_of(address))
    try:
        values = read_form(REGISTRATION, form)
        with browser.services.database.write() as session:
            team = make_pending_team(
                session, values.pop("id"), **values, actor=actor, address=address
            )
            add_member(session, team, person_id, actor=actor)
            act_for(session, browser.secret, person_id, team.id)
    except RecordsError as refusal:
        return _page(browser, refusal=refusal, texts=posted_texts(form))
    return _as_member(browser)


@router.get("/join/{text}")
def show_invitation(
    request: Request, services: ServicesOf, browser: MaybeSignedIn, text: LinkText
) -> Response:
    """Show who invites; nothing happens before somebody signed in says yes."""
    with services.database.read() as session:
        person_id = browser.principal.person_id if browser is not None else None
        invitation, team = find_invitation(session, text, person_id)
        return private_page(
            request,
            "teams/join.html",
            "my",
            team=team.name,
            invited_by=invitation.invited_by,
            expires_at=invitation.expires_at,
            is_used=invitation.used_at is not None,
            text=text,
            person=browser.principal.person_name if browser is not None else "",
            is_member=person_id is not None and is_member(session, team.id, person_id),
            provider=None if services.provider is None else services.provider.name,
            form_token=browser.form_token if browser is not None else "",
        )


@router.post("/join/{text}")
def join(browser: Browser, form: PostedForm, text: LinkText) -> Response:
    """Join the team of an invitation, and act for it."""
    person_id = _person_of(browser)
    with browser.services.database.write() as session:
        team = accept_invitation(session, text, person_id, actor=f"person:{person_id}")
        act_for(session, browser.secret, person_id, team.id)
    return _as_member(browser)


def _as_member(browser: SignedIn) -> Response:
    """Lead to the team's page; an organizer's links are theirs no longer."""
    answer = RedirectResponse(_BACK, status_code=303)
    keep_session(browser.request, answer, browser.secret, is_organizer=False)
    return answer


def _page(
    browser: SignedIn,
    link: str | None = None,
    refusal: RecordsError | None = None,
    texts: Mapping[str, str] = NOTHING_KEPT,
) -> Response:
    who = browser.principal
    if who.person_id is None:
        require_scope(browser, Scope.TOKENS)
        team_of(who)
    may_register = who.person_id is not None and _may_register(browser.services)
    with browser.services.database.read() as session:
        team = None if who.team_id is None else session.get(Team, who.team_id)
        person = None if who.person_id is None else find_person(session, who.person_id)
        teams = [] if person is None else teams_of(session, person.id)
        members = [] if team is None else members_of(session, team.id)
        people = [f"person:{member.id}" for member, _ in members]
        return my_page(
            browser,
            "teams/team.html",
            team=team,
            **({} if team is None else _facts(session, team)),
            members=members,
            removal=removal_of(session, person.id) if person is not None and team is None else None,
            made_by={} if team is None else live_tokens_by_maker(session, people, team.id),
            invitations=[] if team is None else open_invitations(session, team.id),
            may_invite=may_invite(who),
            roles=[] if person is None else _roles(person, who, teams),
            may_register=may_register and not teams,
            provider=None if browser.services.provider is None else browser.services.provider.name,
            link=link,
            refusal=refusal,
            fields=filled_fields(REGISTRATION, texts),
        )


def _facts(session: Session, team: Team) -> dict[str, Any]:
    """How much there is of a team: submissions, tokens that work, addresses that are told."""
    contacts = list_contacts(session, team.id)
    return {
        "n_submissions": counts_by_team(session).get(team.id, 0),
        "n_tokens": live_tokens_by_team(session).get(team.id, 0),
        "n_contacts": sum(contact.confirmed_at is not None for contact in contacts),
    }


def _roles(person: Person, who: Principal, teams: list[Team]) -> list[tuple[int | None, str]]:
    """Return for whom a person may act, if there is a choice: ids of teams, None as an organizer."""
    roles: list[tuple[int | None, str]] = [(team.id, team.name) for team in teams]
    if person.is_organizer:
        roles.insert(0, (None, "Organizer"))
    acted_for = [] if who.team_id is None else [who.team_id]
    is_settled = [team_id for team_id, _ in roles] == acted_for
    return [] if is_settled else roles


def _may_register(services: Services) -> bool:
    with services.database.read() as session:
        return self_registration_is_on(session, services.settings.self_registration)


def _person_of(browser: SignedIn) -> str:
    if browser.principal.person_id is None:
        detail = "You signed in with a token. Sign out, and sign in as a person to do this."
        raise ApiProblem(ProblemCode.NOT_ALLOWED, detail)
    return browser.principal.person_id
