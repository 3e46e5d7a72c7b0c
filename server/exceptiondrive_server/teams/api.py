"""Self-registration of teams, if the operator has enabled it."""

from typing import Annotated

from fastapi import APIRouter, Request
from pydantic import BaseModel, Field

from exceptiondrive_records.accounts.attempts import count_attempt, registration_keys_of
from exceptiondrive_records.teams.teams import register_team, self_registration_is_on
from exceptiondrive_schemas.api.problems import ProblemCode
from exceptiondrive_server.web.auth import ServicesOf, address_of
from exceptiondrive_server.web.forms import Form
from exceptiondrive_server.web.problem_vocabulary import ApiProblem
from exceptiondrive_server.web.problems import problem_responses

router = APIRouter(tags=["access"])


class NewRegistration(Form):
    """A team that asks to take part."""

    id: Annotated[str, Field(max_length=64, description="lower-case letters, digits, hyphens")]
    name: Annotated[str, Field(max_length=400, description="as the board shows it")]
    note: Annotated[str, Field(max_length=2000, description="who you are, for organizers alone")]


class Registration(BaseModel):
    """A registered team with its first token, which is shown here and never again."""

    team: str
    """Id of the team."""
    token: str
    """To send as `Authorization: Bearer ...`."""
    is_approved: bool
    """False: an organizer has to look at it before the team may submit."""


@router.post(
    "/registrations",
    operation_id="registerTeam",
    status_code=201,
    responses=problem_responses(
        ProblemCode.NOT_ALLOWED, ProblemCode.CONFLICT, ProblemCode.TOO_MANY_REQUESTS
    ),
)
def post_registration(
    request: Request, services: ServicesOf, wanted: NewRegistration
) -> Registration:
    """Register a team; it may submit when an organizer has approved it."""
    with services.database.read() as session:
        is_on = self_registration_is_on(session, services.settings.self_registration)
    if not is_on:
        detail = "Teams do not register themselves here; ask an organizer for a token."
        raise ApiProblem(ProblemCode.NOT_ALLOWED, detail)
    address = address_of(request)
    with services.database.write() as session:
        count_attempt(session, registration_keys_of(address))
    with services.database.write() as session:
        text, _, team = register_team(session, wanted.id, wanted.name, wanted.note, address=address)
        return Registration(team=team.slug, token=text, is_approved=False)
