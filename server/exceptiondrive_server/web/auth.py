"""Authentication of requests: bearer tokens to principals, and the rights that a route requires."""

from collections.abc import Awaitable, Callable
from typing import Annotated, Any

from fastapi import Depends, Request, Security
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer

from exceptiondrive_records.accounts.tokens import Principal, Scope, note_use, verify_token
from exceptiondrive_schemas.api.problems import ProblemCode
from exceptiondrive_server.web.organizer_rights import require_right
from exceptiondrive_server.web.problem_vocabulary import ApiProblem
from exceptiondrive_server.web.services import Services, services_at_hand

_bearer = HTTPBearer(
    auto_error=False,
    scheme_name="token",
    description="`Authorization: Bearer edk_...`, a token of your team or of an organizer.",
)

_NO_TOKEN = "Send a token: Authorization: Bearer ..."
ServicesOf = Annotated[Services, Depends(services_at_hand)]
Credentials = Annotated[HTTPAuthorizationCredentials | None, Security(_bearer)]


def principal_or_none(services: ServicesOf, credentials: Credentials) -> Principal | None:
    """Return who asks, or None without a token.

    Raises:
        ApiProblem: A token was sent that is wrong, expired or revoked: always the same words.
    """
    if credentials is None:
        return None
    with services.database.read() as session:
        principal = verify_token(session, credentials.credentials)
    if principal is None:
        raise ApiProblem(
            ProblemCode.NOT_SIGNED_IN, "The token is not valid: unknown, expired or revoked."
        )
    note_use(services.database, principal)
    return principal


TOKEN_IS_OPTIONAL: dict[str, Any] = {"security": [{}]}
"""For `openapi_extra`: FastAPI adds it to the schemes, as the choice to send none."""
MaybePrincipal = Annotated[Principal | None, Depends(principal_or_none)]


def require(scope: Scope) -> Callable[[Principal | None], Awaitable[Principal]]:
    """Return a dependency that demands a token with this scope."""

    async def demand(principal: MaybePrincipal) -> Principal:
        if principal is None:
            raise ApiProblem(ProblemCode.NOT_SIGNED_IN, _NO_TOKEN)
        if scope not in principal.scopes:
            detail = (
                f"This needs a token with the scope {scope.value!r}; `exceptiondrive whoami` "
                "shows those of yours."
            )
            raise ApiProblem(ProblemCode.NOT_ALLOWED, detail)
        return principal

    return demand


Submitter = Annotated[Principal, Depends(require(Scope.SUBMIT))]
Reader = Annotated[Principal, Depends(require(Scope.READ_OWN))]
TokenKeeper = Annotated[Principal, Depends(require(Scope.TOKENS))]


def organizer(request: Request, services: ServicesOf, principal: MaybePrincipal) -> Principal:
    """Return the organizer who asks, if this route is for the role that they have.

    Raises:
        ApiProblem: No token was sent, or its role is not enough.
    """
    if principal is None:
        raise ApiProblem(ProblemCode.NOT_SIGNED_IN, _NO_TOKEN)
    require_right(request, services, principal)
    return principal


Organizer = Annotated[Principal, Depends(organizer)]


def sees_hidden(principal: Principal | None) -> bool:
    """Whether who asks may see hidden phases: organizers of the whole site alone."""
    return principal is not None and principal.is_organizer


def address_of(request: Request) -> str:
    """Return the network address that a request comes from."""
    return request.client.host if request.client else "unknown"


def team_of(principal: Principal) -> int:
    """Return the team that a principal acts for.

    Raises:
        ApiProblem: The token belongs to no team.
    """
    if principal.team_id is None:
        raise ApiProblem(ProblemCode.NOT_ALLOWED, "This token belongs to no team; use a team's.")
    return principal.team_id


def own_team(principal: Principal, phase_id: str | None = None) -> int | None:
    """Return the team that a principal is confined to; None for an organizer, of the phase if given.

    Raises:
        ApiProblem: It has no team, and organizes other phases or none.
    """
    if principal.organizes(phase_id):
        return None
    if principal.role is not None and principal.team_id is None:
        own = ", ".join(sorted(principal.phases))
        detail = f"Your role is for {own} alone: ask for the submissions of that phase (`--phase`)."
        raise ApiProblem(ProblemCode.NOT_ALLOWED, detail)
    return team_of(principal)
