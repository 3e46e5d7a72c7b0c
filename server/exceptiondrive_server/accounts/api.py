"""A team's own tokens, for a token with the scope `tokens`. Tokens of other teams answer 404."""

from typing import Annotated

from fastapi import APIRouter, Path
from pydantic import Field

from exceptiondrive_records.accounts.makers import left_behind
from exceptiondrive_records.accounts.tables import Token
from exceptiondrive_records.accounts.tokens import (
    DEFAULT_KEEP_DAYS,
    MAX_KEEP_DAYS,
    PARTICIPANT_SCOPES,
    Scope,
    issue_team_token,
    revoke_team_token,
    rotate_team_token,
    team_tokens,
)
from exceptiondrive_schemas.api.problems import ProblemCode
from exceptiondrive_schemas.api.submission import Me
from exceptiondrive_schemas.datetimes import Time
from exceptiondrive_server.accounts.queries import (
    IssuedToken,
    RevokedToken,
    TokenView,
    team_token_views,
)
from exceptiondrive_server.web.auth import MaybePrincipal, ServicesOf, TokenKeeper, team_of
from exceptiondrive_server.web.forms import Form
from exceptiondrive_server.web.problem_vocabulary import ApiProblem
from exceptiondrive_server.web.problems import problem_responses
from exceptiondrive_server.web.services import Services

_REFUSALS = (ProblemCode.NOT_SIGNED_IN, ProblemCode.NOT_ALLOWED)
router = APIRouter(prefix="/tokens", tags=["access"], responses=problem_responses(*_REFUSALS))
TokenId = Annotated[str, Path(max_length=64, description="id of a token of the team")]
_MISSING = problem_responses(*_REFUSALS, ProblemCode.NOT_FOUND, ProblemCode.CONFLICT)


class NewTeamToken(Form):
    """A token to be issued for one's own team."""

    name: Annotated[str, Field(min_length=1, max_length=80)]
    scopes: list[Scope] = Field(default=list(PARTICIPANT_SCOPES), min_length=1)
    """Only such as the asker's own token has."""
    expires_at: Time | None = None


class Rotation(Form):
    """How long the old token works on."""

    keep_days: Annotated[int, Field(strict=True, ge=0, le=MAX_KEEP_DAYS)] = DEFAULT_KEEP_DAYS


@router.get("", operation_id="listOwnTokens")
def get_own_tokens(services: ServicesOf, keeper: TokenKeeper) -> list[TokenView]:
    """List the team's tokens, newest first, without their secrets."""
    team_id = team_of(keeper)
    with services.database.read() as session:
        return team_token_views(session, team_id, team_tokens(session, keeper))


@router.post("", operation_id="issueOwnToken", status_code=201, responses=_MISSING)
def post_own_token(services: ServicesOf, keeper: TokenKeeper, token: NewTeamToken) -> IssuedToken:
    """Issue a token with no more rights than your own; its text is shown only in this response."""
    team_id = team_of(keeper)
    with services.database.write() as session:
        text, made = issue_team_token(
            session, keeper, token.name, tuple(token.scopes), token.expires_at
        )
    return _issued_token(services, team_id, text, made)


@router.post(
    "/{token_id}/rotate", operation_id="rotateOwnToken", status_code=201, responses=_MISSING
)
def post_rotation(
    services: ServicesOf, keeper: TokenKeeper, token_id: TokenId, rotation: Rotation
) -> IssuedToken:
    """Issue the successor of a token; the old one stays valid for `keep_days`."""
    team_id = team_of(keeper)
    with services.database.write() as session:
        text, made = rotate_team_token(session, keeper, token_id, rotation.keep_days)
    return _issued_token(services, team_id, text, made)


@router.post("/{token_id}/revoke", operation_id="revokeOwnToken", responses=_MISSING)
def post_own_revocation(
    services: ServicesOf, keeper: TokenKeeper, token_id: TokenId
) -> RevokedToken:
    """Revoke a token of the team for good, even your own; `still_work` lists live tokens it issued."""
    team_id = team_of(keeper)
    with services.database.write() as session:
        token = revoke_team_token(session, keeper, token_id)
        left = left_behind(session, f"token:{token.id}", team_id)
        view, *made = team_token_views(session, team_id, [token, *left])
        return RevokedToken(**dict(view), still_work=tuple(made))


def _issued_token(services: Services, team_id: int, text: str, made: Token) -> IssuedToken:
    with services.database.read() as session:
        (view,) = team_token_views(session, team_id, [made])
    return IssuedToken(token=text, view=view)


# Who a token speaks for.


me_router = APIRouter(tags=["access"])


@me_router.get("/me", operation_id="whoAmI", responses=problem_responses(ProblemCode.NOT_SIGNED_IN))
def get_me(principal: MaybePrincipal) -> Me:
    """Show the token's team or organizer role, its scopes and expiry."""
    if principal is None:
        raise ApiProblem(ProblemCode.NOT_SIGNED_IN, "Send a token: Authorization: Bearer ...")
    return Me(
        team=principal.team_name,
        token_name=principal.token_name,
        scopes=tuple(sorted(principal.scopes)),
        expires_at=principal.expires_at,
        role=principal.role,
        phases=tuple(sorted(principal.phases)),
    )
