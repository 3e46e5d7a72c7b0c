"""People who signed in through the provider, and the organizer roles granted to them."""

from functools import partial
from typing import Annotated

from fastapi import APIRouter, Path, Query
from fastapi.responses import Response
from sqlalchemy.orm import Session

from exceptiondrive_records.accounts.makers import left_behind
from exceptiondrive_records.accounts.people import find_person, list_people, set_organizer
from exceptiondrive_records.accounts.roles import OrganizerRole
from exceptiondrive_records.accounts.tables import Person
from exceptiondrive_records.accounts.tokens import names_of_actors
from exceptiondrive_records.participation.forgetting import forget_person
from exceptiondrive_schemas.api.form_fields import FormField
from exceptiondrive_server.web.auth import ServicesOf
from exceptiondrive_server.web.forms import REASON
from exceptiondrive_server.web.organizer_frame import (
    OrganizerBrowser,
    Step,
    has_text,
    organizer_page,
    step_at,
)

router = APIRouter(prefix="/organize/people", include_in_schema=False)
HERE = "/organize/people"
PersonId = Annotated[str, Path(max_length=64)]


@router.get("")
def show_people(
    browser: OrganizerBrowser, q: Annotated[str, Query(max_length=80)] = ""
) -> Response:
    """List everybody who ever signed in through the provider, or those with a text, with their roles."""
    with browser.services.database.read() as session:
        people = list_people(session)
    return organizer_page(
        browser,
        "accounts/organizer_people.html",
        "people",
        people=[
            one
            for one in people
            if has_text(q, one.name, one.email or "", one.organizer_role or "")
        ],
        find=q,
        n_all=len(people),
    )


@step_at(router, "/{person_id}")
def role_of(services: ServicesOf, person_id: PersonId) -> Step:
    """Give a person a role, or take it."""
    with services.database.read() as session:
        person = find_person(session, person_id)
        facts = _facts(session, person)

    def kept(session: Session) -> dict[str, str]:
        return _role_texts(find_person(session, person_id, lock=True))

    def take(session: Session, role: str | None, phases: str | None, actor: str) -> None:
        wanted = None if role is None else OrganizerRole(role)
        set_organizer(session, person_id, wanted, (phases or "").split(), actor=actor)

    return Step(
        section="people",
        title="Role of a person",
        meaning="It applies from their next request on. An owner can change everything, a helper "
        "approves teams and looks after submissions, and read-only changes nothing.",
        button="Set the role",
        back=HERE,
        back_words="People",
        take=take,
        done="role_set",
        fields=(
            FormField(
                "role",
                "Role",
                "choice",
                options=tuple((str(role), str(role)) for role in OrganizerRole),
                empty="none",
            ),
            FormField("phases", "Phases", hint="Ids, separated by spaces; empty: the whole site."),
        ),
        texts=_role_texts(person),
        kept=kept,
        facts=facts,
        command=f"exceptiondrive organizer people set {person_id} --role helper --phase ID",
    )


@step_at(router, "/{person_id}/forget")
def forget(services: ServicesOf, person_id: PersonId) -> Step:
    """Forget a person."""
    with services.database.read() as session:
        person = find_person(session, person_id)
        facts = _facts(session, person)

    return Step(
        section="people",
        title="Forget a person",
        meaning="Name, address and sessions are removed from the records, and the person leaves all teams, "
        "whose submissions, tokens and addresses stay. Do not name anybody in the reason. This cannot "
        "be undone; whoever signs in again is somebody new.",
        button="Forget",
        back=HERE,
        back_words="People",
        take=partial(forget_person, person_id=person_id),
        done="person_forgotten",
        fields=(REASON,),
        facts=facts,
        command=f'exceptiondrive organizer people forget {person_id} --reason "…"',
        is_grave=True,
        blockers=("The person is an organizer: remove their role first.",)
        if person.is_organizer
        else (),
    )


def _facts(session: Session, person: Person) -> tuple[tuple[str, str | tuple[str, ...]], ...]:
    left = {f"token:{one.id}": one.prefix for one in left_behind(session, f"person:{person.id}")}
    names = names_of_actors(session, left)
    made = tuple(f"{names[actor]}, {prefix}" for actor, prefix in left.items())
    return (
        ("Name", person.name),
        ("Email", person.email or "none"),
        ("Id", person.id),
        *([("Tokens that they made, which keep working until revoked", made)] if made else ()),
    )


def _role_texts(person: Person) -> dict[str, str]:
    return {"role": person.organizer_role or "", "phases": " ".join(person.organizer_phases)}
