"""Who a token speaks for."""

from fastapi import APIRouter

from exceptiondrive_schemas.problems import ProblemCode
from exceptiondrive_schemas.submission import Me
from exceptiondrive_server.auth import MaybePrincipal
from exceptiondrive_server.problem_vocabulary import ApiProblem
from exceptiondrive_server.problems import (
    problem_responses,
)

router = APIRouter(tags=["access"])


@router.get("/me", operation_id="whoAmI", responses=problem_responses(ProblemCode.NOT_SIGNED_IN))
def get_me(principal: MaybePrincipal) -> Me:
    """Show team, scopes and expiry of the token."""
    if principal is None:
        raise ApiProblem(ProblemCode.NOT_SIGNED_IN, "Send a token: Authorization: Bearer ...")
    return Me(
        team=principal.team_name,
        token_name=principal.token_name,
        scopes=tuple(sorted(principal.scopes)),
        expires_at=principal.expires_at,
    )
