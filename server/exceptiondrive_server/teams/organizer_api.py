"""Teams and their tokens, as organizers manage them."""

from datetime import datetime
from typing import Annotated

from fastapi import APIRouter, Path
from pydantic import BaseModel, Field, StrictBool

from exceptiondrive_records.accounts.makers import left_behind
from exceptiondrive_records.accounts.tokens import (
    TEAM_SCOPES,
    Scope,
    issue_token,
    list_tokens,
    revoke_token,
)
from exceptiondrive_records.participation.changes import MAX_AFFILIATION, approve_team
from exceptiondrive_records.participation.importing import make_team
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.teams.teams import find_team, list_teams, refuse_team
from exceptiondrive_schemas.datetimes import Time
from exceptiondrive_server.accounts.queries import (
    IssuedToken,
    RevokedToken,
    TokenView,
    token_views,
)
from exceptiondrive_server.participation.queries import standings_of_teams
from exceptiondrive_server.web.auth import Organizer, ServicesOf
from exceptiondrive_server.web.forms import Action, Form
from exceptiondrive_server.web.path_ids import TeamId

router = APIRouter()


class NewTeam(Form):
    """A team to be made."""

    id: Annotated[
        str, Field(max_length=64, json_schema_extra={"pattern": "^[a-z0-9][a-z0-9-]{0,63}$"})
    ]
    name: Annotated[str, Field(min_length=1, max_length=80)]
    affiliation: Annotated[str, Field(max_length=MAX_AFFILIATION)] = ""
    email: Annotated[str, Field(max_length=400)] = ""
    """Where its notices go, once whoever reads there confirms it."""
    is_reference: StrictBool = False


class TeamView(BaseModel):
    """A team as organizers see it."""

    id: str = Field(validation_alias="slug")
    name: str
    affiliation: str
    is_reference: bool
    created_at: datetime
    pending_since: datetime | None
    """Registered itself then, and waits for approval."""
    registration_note: str | None
    standing: str = ""
    """Why it does not take part as others do, such as `disqualified in test`; empty: it does."""


class NewToken(Form):
    """A token to be issued."""

    name: Annotated[str, Field(min_length=1, max_length=80)]
    scopes: list[Scope] = Field(default=list(TEAM_SCOPES), min_length=1)
    expires_at: Time | None = None


@router.get("/teams", operation_id="listTeams")
def get_teams(services: ServicesOf) -> list[TeamView]:
    """List all teams."""
    with services.database.read() as session:
        standings = standings_of_teams(session)
        return [_team(team, standings.get(team.id, "")) for team in list_teams(session)]


@router.post("/teams", operation_id="createTeam", status_code=201)
def post_team(services: ServicesOf, organizer: Organizer, team: NewTeam) -> TeamView:
    """Create a team."""
    with services.database.write() as session:
        given = team.model_dump()
        return _team(make_team(session, given.pop("id"), **given, actor=organizer.actor))


@router.post("/teams/{team_id}/approve", operation_id="approveTeam")
def post_approval(services: ServicesOf, organizer: Organizer, team_id: TeamId) -> TeamView:
    """Approve a team that registered itself, so that it may submit."""
    with services.database.write() as session:
        return _team(approve_team(session, team_id, actor=organizer.actor))


@router.post("/teams/{team_id}/refuse", operation_id="refuseTeam")
def post_refusal(
    services: ServicesOf, organizer: Organizer, team_id: TeamId, action: Action
) -> TeamView:
    """Refuse a registration: the team and its tokens are deleted, the reason stays in the audit log."""
    with services.database.write() as session:
        refused = _team(find_team(session, team_id))
        refuse_team(session, team_id, reason=action.reason, actor=organizer.actor)
    return refused


@router.get("/teams/{team_id}/tokens", operation_id="listTokens")
def get_tokens(services: ServicesOf, team_id: TeamId) -> list[TokenView]:
    """List a team's tokens, without their secrets."""
    with services.database.read() as session:
        team = find_team(session, team_id)
        return token_views(session, list_tokens(session, team.id), team.id)


@router.post("/teams/{team_id}/tokens", operation_id="issueToken", status_code=201)
def post_token(
    services: ServicesOf, organizer: Organizer, team_id: TeamId, token: NewToken
) -> IssuedToken:
    """Issue a token for a team; its text is shown only in this response."""
    with services.database.write() as session:
        text, made = issue_token(
            session,
            find_team(session, team_id).id,
            token.name,
            tuple(token.scopes),
            token.expires_at,
            actor=organizer.actor,
        )
    with services.database.read() as session:
        (view,) = token_views(session, [made], made.team_id)
    return IssuedToken(token=text, view=view)


@router.post("/tokens/{token_id}/revoke", operation_id="revokeToken")
def post_revocation(
    services: ServicesOf, organizer: Organizer, token_id: Annotated[str, Path(max_length=64)]
) -> RevokedToken:
    """Revoke a token for good; `still_work` lists live tokens it issued."""
    with services.database.write() as session:
        token = revoke_token(session, token_id, actor=organizer.actor)
        left = left_behind(session, f"token:{token.id}", token.team_id)
        view, *made = token_views(session, [token, *left], token.team_id)
        return RevokedToken(**dict(view), still_work=tuple(made))


def _team(team: Team, standing: str = "") -> TeamView:
    seen = TeamView.model_validate(team, from_attributes=True)
    return seen.model_copy(update={"standing": standing})
