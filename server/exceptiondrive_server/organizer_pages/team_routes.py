"""Teams: list, make, approve or refuse, and their tokens."""

from collections.abc import Mapping
from typing import Annotated

from fastapi import APIRouter, Path, Query, Request
from fastapi.responses import Response
from sqlalchemy.orm import Session

from exceptiondrive_records.audit import audit_page
from exceptiondrive_records.clock import database_now
from exceptiondrive_records.errors import NotFound, RecordsError
from exceptiondrive_records.submissions import counts_by_team
from exceptiondrive_records.tables import Team
from exceptiondrive_records.teams import create_team, find_team, list_teams
from exceptiondrive_records.tokens import (
    TEAM_SCOPES,
    issue_token,
    list_tokens,
    live_tokens_by_team,
    names_of_actors,
)
from exceptiondrive_server.auth import ServicesOf
from exceptiondrive_server.browser_session import PostedForm, SignedIn
from exceptiondrive_server.organizer_pages.audit_view import history_lines
from exceptiondrive_server.organizer_pages.forms import filled, read, typed
from exceptiondrive_server.organizer_pages.frame import (
    OrganizerBrowser,
    go,
    organizer_page,
    status_of,
)
from exceptiondrive_server.organizer_pages.team_view import (
    NEW_TEAM,
    NEW_TOKEN,
    TeamLine,
    TeamPage,
    chosen_scopes,
    team_line,
    token_lines,
)
from exceptiondrive_server.services import Services

router = APIRouter(prefix="/organize/teams", include_in_schema=False)
Slug = Annotated[str, Path(max_length=64)]
HISTORY = 50
USUAL = {f"may_{n}": "yes" for n in range(len(TEAM_SCOPES))}
"""The first token of a team has every right that a team may have."""


@router.get("")
def show_teams(
    request: Request,
    services: ServicesOf,
    browser: OrganizerBrowser,
    show: Annotated[str, Query(max_length=20)] = "",
) -> Response:
    """List the teams; those that wait for approval come first."""
    return _list(request, services, browser, only_pending=show == "pending")


@router.post("")
def post_team(
    request: Request, services: ServicesOf, browser: OrganizerBrowser, form: PostedForm
) -> Response:
    """Make a team."""
    try:
        values = read(NEW_TEAM, form)
        with services.database.write() as session:
            create_team(
                session,
                values["id"],
                values["name"],
                is_reference=values["is_reference"],
                actor=browser.principal.actor,
            )
    except RecordsError as refusal:
        return _list(request, services, browser, texts=typed(form), refusal=refusal)
    return go(f"/organize/teams/{values['id']}", "team_created")


@router.get("/{team_id}")
def show_team(
    request: Request, services: ServicesOf, browser: OrganizerBrowser, team_id: Slug
) -> Response:
    """Show a team and its tokens."""
    return _team(request, services, browser, team_id)


@router.post("/{team_id}/tokens")
def post_token(
    request: Request,
    services: ServicesOf,
    browser: OrganizerBrowser,
    form: PostedForm,
    team_id: Slug,
) -> Response:
    """Issue a token for a team, and show its text this once."""
    try:
        values = read(NEW_TOKEN, form)
        with services.database.write() as session:
            text, _ = issue_token(
                session,
                find_team(session, team_id).id,
                values["name"],
                chosen_scopes(values),
                values["expires_at"],
                actor=browser.principal.actor,
            )
    except NotFound:
        raise
    except RecordsError as refusal:
        return _team(request, services, browser, team_id, texts=typed(form), refusal=refusal)
    return _team(request, services, browser, team_id, issued=text)


def _list(
    request: Request,
    services: Services,
    browser: SignedIn,
    *,
    only_pending: bool = False,
    texts: Mapping[str, str] | None = None,
    refusal: RecordsError | None = None,
) -> Response:
    with services.database.read() as session:
        lines = [line for line in _lines(session) if line.pending_since or not only_pending]
    return organizer_page(
        request,
        browser,
        "teams.html",
        "teams",
        status=200 if refusal is None else status_of(refusal),
        lines=sorted(lines, key=lambda line: line.pending_since is None),
        only_pending=only_pending,
        fields=filled(NEW_TEAM, texts or {}),
        refusal=None if refusal is None else str(refusal),
    )


def _lines(session: Session) -> list[TeamLine]:
    tokens, counts = live_tokens_by_team(session), counts_by_team(session)
    return [
        team_line(team, n_tokens=tokens.get(team.id, 0), n_submissions=counts.get(team.id, 0))
        for team in list_teams(session)
    ]


def _team(
    request: Request,
    services: Services,
    browser: SignedIn,
    slug: str,
    *,
    issued: str | None = None,
    texts: Mapping[str, str] | None = None,
    refusal: RecordsError | None = None,
) -> Response:
    with services.database.read() as session:
        content = _page(session, find_team(session, slug), issued)
    return organizer_page(
        request,
        browser,
        "team.html",
        "teams",
        status=200 if refusal is None else status_of(refusal),
        page=content,
        fields=filled(NEW_TOKEN, USUAL if texts is None else texts),
        refusal=None if refusal is None else str(refusal),
    )


def _page(session: Session, team: Team, issued: str | None) -> TeamPage:
    lines = audit_page(session, subject=team.slug, limit=HISTORY)
    names = names_of_actors(session, (line.actor for line in lines))
    return TeamPage(
        team=team,
        tokens=token_lines(list_tokens(session, team.id), database_now(session)),
        issued=issued,
        history=history_lines(lines, names),
        n_submissions=counts_by_team(session).get(team.id, 0),
    )
