"""People, as organizers manage them."""

from datetime import datetime
from typing import Annotated

from fastapi import APIRouter, Path
from pydantic import BaseModel, Field, StrictBool
from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.makers import left_behind
from exceptiondrive_records.accounts.people import invite, list_people, set_organizer
from exceptiondrive_records.accounts.roles import MAX_PHASES, OrganizerRole
from exceptiondrive_records.accounts.tables import Person
from exceptiondrive_records.participation.forgetting import forget_person
from exceptiondrive_records.teams.teams import find_team
from exceptiondrive_server.accounts.queries import TokenView, token_views
from exceptiondrive_server.web.auth import Organizer, ServicesOf
from exceptiondrive_server.web.forms import Action, Form
from exceptiondrive_server.web.path_ids import TeamId

router = APIRouter()
PersonId = Annotated[str, Path(max_length=64, description="id of a person")]


class PersonView(BaseModel):
    """Somebody who signed in through the provider."""

    id: str
    name: str
    email: str | None
    is_organizer: bool
    role: OrganizerRole | None
    phases: tuple[str, ...]
    """To which the role is confined; none: it is for the whole site."""
    signed_in_at: datetime


class ChangedPerson(PersonView):
    """A person whose role was set, or who was forgotten, and what works on."""

    still_work: tuple[TokenView, ...]
    """Tokens that they made, or that were made with one of these: none of them ended."""


class OrganizerSwitch(Form):
    """Whether a person is an organizer."""

    is_organizer: StrictBool
    role: OrganizerRole = OrganizerRole.OWNER
    phases: tuple[str, ...] = Field(default=(), max_length=MAX_PHASES)
    """To confine the role to; none: it is for the whole site."""


class NewInvitation(BaseModel):
    """An invitation: its path is shown here and never again."""

    path: str
    expires_at: datetime


@router.get("/people", operation_id="listPeople")
def get_people(services: ServicesOf) -> list[PersonView]:
    """List all people who ever signed in through the provider."""
    with services.database.read() as session:
        return [_person(person) for person in list_people(session)]


@router.post("/people/{person_id}/organizer", operation_id="switchOrganizer")
def post_organizer(
    services: ServicesOf, organizer: Organizer, person_id: PersonId, wanted: OrganizerSwitch
) -> ChangedPerson:
    """Grant or revoke a person's organizer role; `still_work` lists live tokens they issued."""
    role = wanted.role if wanted.is_organizer else None
    with services.database.write() as session:
        person = set_organizer(session, person_id, role, wanted.phases, actor=organizer.actor)
        return _changed_person(session, person)


@router.post("/people/{person_id}/forget", operation_id="forgetPerson")
def post_forgetting(
    services: ServicesOf, organizer: Organizer, person_id: PersonId, action: Action
) -> ChangedPerson:
    """Remove a person from their teams and delete their data; only their id stays.

    The reason stays in the audit log, so name nobody in it. `still_work` lists live tokens they issued.
    """
    with services.database.write() as session:
        person = forget_person(session, person_id, reason=action.reason, actor=organizer.actor)
        return _changed_person(session, person)


@router.post("/teams/{team_id}/invitations", operation_id="inviteToTeam", status_code=201)
def post_invitation(services: ServicesOf, organizer: Organizer, team_id: TeamId) -> NewInvitation:
    """Create an invitation link, with which one person can join a team, once."""
    with services.database.write() as session:
        team = find_team(session, team_id)
        text, made = invite(session, team.id, "an organizer", actor=organizer.actor)
        return NewInvitation(path=f"/join/{text}", expires_at=made.expires_at)


def _changed_person(session: Session, person: Person) -> ChangedPerson:
    left = left_behind(session, f"person:{person.id}")
    return ChangedPerson(
        **dict(_person(person)), still_work=tuple(token_views(session, left, None))
    )


def _person(person: Person) -> PersonView:
    return PersonView(
        id=person.id,
        name=person.name,
        email=person.email,
        is_organizer=person.is_organizer,
        role=None if person.organizer_role is None else OrganizerRole(person.organizer_role),
        phases=tuple(person.organizer_phases),
        signed_in_at=person.signed_in_at,
    )
