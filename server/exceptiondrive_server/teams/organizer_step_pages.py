"""Decisions on teams and tokens, each confirmed on a page of its own."""

from typing import Annotated

from fastapi import APIRouter, Path, Request
from fastapi.responses import Response
from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.tables import Token
from exceptiondrive_records.accounts.tokens import find_token, revoke_token
from exceptiondrive_records.db.errors import NotFound, RecordsError
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.teams.teams import approve_team, find_team, refuse_team
from exceptiondrive_server.accounts.browser_session import PostedForm
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.forms import REASON, read, typed
from exceptiondrive_server.web.organizer_frame import OrganizerBrowser, Step, go, step_page

router = APIRouter(prefix="/organize", include_in_schema=False)
Slug = Annotated[str, Path(max_length=64)]
TokenId = Annotated[str, Path(max_length=64)]


@router.get("/teams/{team_id}/approve")
def show_approval(
    request: Request, services: ServicesOf, browser: OrganizerBrowser, team_id: Slug
) -> Response:
    """Ask whether a team may submit."""
    with services.database.read() as session:
        step = _approval(find_team(session, team_id))
    return step_page(request, browser, step)


@router.post("/teams/{team_id}/approve")
def post_approval(
    services: ServicesOf, browser: OrganizerBrowser, form: PostedForm, team_id: Slug
) -> Response:
    """Let a team that registered itself submit."""
    with services.database.write() as session:
        approve_team(session, team_id, actor=browser.principal.actor)
    return go(f"/organize/teams/{team_id}", "team_approved")


@router.get("/teams/{team_id}/refuse")
def show_refusal(
    request: Request, services: ServicesOf, browser: OrganizerBrowser, team_id: Slug
) -> Response:
    """Ask whether a registration shall be refused."""
    with services.database.read() as session:
        step = _refusal(find_team(session, team_id))
    return step_page(request, browser, step)


@router.post("/teams/{team_id}/refuse")
def post_refusal(
    request: Request,
    services: ServicesOf,
    browser: OrganizerBrowser,
    form: PostedForm,
    team_id: Slug,
) -> Response:
    """Refuse a registration."""
    try:
        reason = read((REASON,), form)["reason"]
        with services.database.write() as session:
            refuse_team(session, team_id, reason=reason, actor=browser.principal.actor)
    except NotFound:
        raise
    except RecordsError as refusal:
        with services.database.read() as session:
            step = _refusal(find_team(session, team_id))
        return step_page(request, browser, step, texts=typed(form), refusal=refusal)
    return go("/organize/teams", "team_refused")


@router.get("/tokens/{token_id}/revoke")
def show_revocation(
    request: Request, services: ServicesOf, browser: OrganizerBrowser, token_id: TokenId
) -> Response:
    """Ask whether a token shall be revoked."""
    with services.database.read() as session:
        token = find_token(session, token_id)
        step = _revocation(session, token)
    return step_page(request, browser, step)


@router.post("/tokens/{token_id}/revoke")
def post_revocation(
    request: Request,
    services: ServicesOf,
    browser: OrganizerBrowser,
    form: PostedForm,
    token_id: TokenId,
) -> Response:
    """Revoke a token for good."""
    with services.database.read() as session:
        step = _revocation(session, find_token(session, token_id))
    try:
        with services.database.write() as session:
            revoke_token(session, token_id, actor=browser.principal.actor)
    except RecordsError as refusal:
        return step_page(request, browser, step, refusal=refusal)
    return go(step.back, "token_revoked")


def _approval(team: Team) -> Step:
    return Step(
        section="teams",
        title=f"Approve {team.name}",
        meaning="The team may submit from now on.",
        button="Approve",
        back=f"/organize/teams/{team.slug}",
        back_words="The team",
        facts=(("Id", team.slug), ("They say", team.registration_note or "nothing")),
        command=f"exceptiondrive organizer teams approve {team.slug}",
    )


def _refusal(team: Team) -> Step:
    return Step(
        section="teams",
        title=f"Refuse {team.name}",
        meaning="The team and its tokens are removed; its id and name are free again. The reason "
        "stays in the audit log. The team is not told: write to them if you wish.",
        button="Refuse",
        back=f"/organize/teams/{team.slug}",
        back_words="The team",
        fields=(REASON,),
        facts=(("Id", team.slug), ("They say", team.registration_note or "nothing")),
        command=f'exceptiondrive organizer teams refuse {team.slug} --reason "…"',
        is_grave=True,
    )


def _revocation(session: Session, token: Token) -> Step:
    team = None if token.team_id is None else session.get(Team, token.team_id)
    return Step(
        section="teams",
        title=f"Revoke {token.name}",
        meaning="It stops working for good; browsers that signed in with it are signed out.",
        button="Revoke",
        back="/organize/teams" if team is None else f"/organize/teams/{team.slug}",
        back_words="Teams" if team is None else "The team",
        facts=(
            ("Begins with", token.prefix),
            ("Team", "none: an organizer's" if team is None else team.name),
            ("May", ", ".join(token.scopes)),
        ),
        command=f"exceptiondrive organizer teams revoke-token {token.id}",
        is_grave=True,
    )
