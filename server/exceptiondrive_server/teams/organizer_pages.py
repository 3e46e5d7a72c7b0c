"""Teams: list, make, approve or refuse, and their tokens."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Annotated

from fastapi import APIRouter, Path, Query, Request
from fastapi.responses import Response
from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.tables import Token
from exceptiondrive_records.accounts.tokens import (
    TEAM_SCOPES,
    Scope,
    is_live,
    issue_token,
    list_tokens,
    live_tokens_by_team,
    names_of_actors,
)
from exceptiondrive_records.audit.log import audit_page
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import NotFound, RecordsError
from exceptiondrive_records.submissions.submissions import counts_by_team
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.teams.teams import create_team, find_team, list_teams
from exceptiondrive_schemas.form_fields import FormField
from exceptiondrive_server.accounts.browser_session import PostedForm, SignedIn
from exceptiondrive_server.audit.organizer_pages import HistoryLine, history_lines
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.forms import filled, read, typed
from exceptiondrive_server.web.organizer_frame import (
    OrganizerBrowser,
    go,
    organizer_page,
    status_of,
)
from exceptiondrive_server.web.services import Services

# Teams as organizers see them: a list, and one team with its tokens.


MEANING = {
    Scope.SUBMIT: "submit and withdraw",
    Scope.READ_OWN: "see the team's submissions",
    Scope.TOKENS: "manage the team's tokens",
    Scope.ORGANIZE: "everything that organizers do",
}
NEW_TEAM = (
    FormField("id", "Id", hint="small letters, digits, hyphens; never changes", is_required=True,
          max_length=64),
    FormField("name", "Name", hint="as the board shows it", is_required=True, max_length=80),
    FormField("is_reference", "A reference row", "yes", "stands on the board, never ranks"),
)  # fmt: skip
NEW_TOKEN = (
    FormField("name", "Name", hint="what it is for", is_required=True, max_length=80),
    *(FormField(f"may_{n}", MEANING[scope], "yes", scope) for n, scope in enumerate(TEAM_SCOPES)),
    FormField("expires_at", "Expires at", "moment", "empty: never"),
)
"""`may_0` and so on stand for the scopes that a team's token may have."""


@dataclass(frozen=True)
class TeamLine:
    """One team in the list."""

    slug: str
    name: str
    is_reference: bool
    created_at: datetime
    pending_since: datetime | None
    note: str | None
    n_tokens: int
    n_submissions: int


@dataclass(frozen=True)
class TokenLine:
    """One token, without its secret."""

    id: str
    name: str
    prefix: str
    rights: str
    last_used_at: datetime | None
    expires_at: datetime | None
    state: str
    is_live: bool


@dataclass(frozen=True)
class TeamPage:
    """Everything that `team.html` needs besides its form."""

    team: Team
    tokens: tuple[TokenLine, ...]
    issued: str | None
    """Text of a new token: shown this once."""
    history: tuple[HistoryLine, ...]
    n_submissions: int


def team_line(team: Team, *, n_tokens: int, n_submissions: int) -> TeamLine:
    """Return a team as the list shows it."""
    return TeamLine(
        slug=team.slug,
        name=team.name,
        is_reference=team.is_reference,
        created_at=team.created_at,
        pending_since=team.pending_since,
        note=team.registration_note,
        n_tokens=n_tokens,
        n_submissions=n_submissions,
    )


def token_lines(tokens: Sequence[Token], now: datetime) -> tuple[TokenLine, ...]:
    """Return tokens, live ones first."""
    lines = [_token(token, now) for token in tokens]
    return tuple(sorted(lines, key=lambda line: not line.is_live))


def chosen_scopes(values: dict[str, object]) -> tuple[Scope, ...]:
    """Return the scopes that were ticked."""
    return tuple(scope for n, scope in enumerate(TEAM_SCOPES) if values[f"may_{n}"])


def _token(token: Token, now: datetime) -> TokenLine:
    lives = is_live(token, now)
    return TokenLine(
        id=token.id,
        name=token.name,
        prefix=token.prefix,
        rights=", ".join(MEANING[Scope(scope)] for scope in token.scopes),
        last_used_at=token.last_used_at,
        expires_at=token.expires_at,
        state="live" if lives else ("revoked" if token.revoked_at else "expired"),
        is_live=lives,
    )


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
        "teams/organizer_teams.html",
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
        "teams/organizer_team.html",
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
