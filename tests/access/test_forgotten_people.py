"""Somebody who asks to be forgotten: what goes, what stays, and who may do it."""

from typing import TYPE_CHECKING

import pytest
from sqlalchemy import select
from tests.access.test_teams_of_people import EVE, Browse, Open, invitation_from, invited_by_token

from exceptiondrive_records.accounts.people import (
    Identity,
    accept_invitation,
    find_invitation,
    invite,
    list_people,
    members_of,
    set_organizer,
    teams_of,
    welcome_person,
)
from exceptiondrive_records.accounts.roles import OrganizerRole
from exceptiondrive_records.accounts.tables import Person
from exceptiondrive_records.accounts.tokens import TEAM_SCOPES, issue_token
from exceptiondrive_records.audit.log import verify_audit
from exceptiondrive_records.db.base import Base
from exceptiondrive_records.db.errors import NotFound
from exceptiondrive_records.teams.teams import switch_self_registration

if TYPE_CHECKING:
    from tests.access.people import RunningProvider
    from tests.support.application import Api

WHY = {"reason": "They asked."}
ADA = ("Ada Example", "ada@example.org", "sub-1")
"""What the provider says of somebody without orders."""


def told_of(site: "Api", *words: str) -> list[str]:
    """Return where in the records any of the words stands: `table.column`."""
    with site.database.read() as session:
        return [
            f"{name}.{column}"
            for name, table in Base.metadata.tables.items()
            for row in session.execute(select(table)).mappings()
            for column, value in row.items()
            if any(word in str(value) for word in words)
        ]


def id_of(site: "Api", name: str) -> str:
    with site.database.read() as session:
        return session.scalars(select(Person.id).where(Person.name == name)).one()


def test_who_is_forgotten_stands_nowhere_in_the_records_and_is_out(
    site: "Api", person: Open, browse: Browse, provider: "RunningProvider"
) -> None:
    ada, eve = person(site), person(site)
    link = invited_by_token(site, browse)
    ada.sign_in(back=link)
    ada.post(link, {}, page=link)
    unused = invitation_from(ada.post("/my/team/invitations", {}, page="/my/team"))
    known_as = id_of(site, "Ada Example")
    assert {"people.name", "people.email", "people.subject", "invitations.invited_by"} == set(
        told_of(site, *ADA)
    )
    page = f"/organize/people/{known_as}/forget"
    organizer = browse(site)
    organizer.sign_in("organizer")
    assert page in organizer.get("/organize/people").text
    done = organizer.post(page, WHY, page=page)
    assert done.headers["location"] == "/organize/people?done=person_forgotten"
    assert told_of(site, *ADA) == []
    assert ada.get("/my/team").headers["location"].startswith("/sign-in?")
    with site.database.read() as session:
        assert members_of(session, site.team_ids["alpha"]) == []
        assert list_people(session) == []
        assert verify_audit(session).is_whole
    assert organizer.get(page).status_code == 404
    provider.order(person=EVE)
    eve.sign_in(back=unused)
    assert eve.get(unused).status_code == 404, "an invitation of theirs is of nobody"
    provider.order()
    ada.sign_in()
    assert id_of(site, "Ada Example") != known_as
    with site.database.read() as session:
        assert teams_of(session, id_of(site, "Ada Example")) == []


def test_an_organizer_is_forgotten_once_the_role_is_taken(api: "Api") -> None:
    with api.database.write() as session:
        ben = welcome_person(session, Identity("https://id.example.org", "ben", "Ben Example")).id
        set_organizer(session, ben, OrganizerRole.HELPER, actor="test")
    path = f"/organizer/people/{ben}"
    refused = api.post(f"{path}/forget", "organizer", json=WHY)
    assert (refused.status_code, "remove their role first" in refused.text) == (409, True)
    assert api.post(f"{path}/organizer", "organizer", json={"is_organizer": False}).is_success
    told = api.post(f"{path}/forget", "organizer", json=WHY)
    assert (told.json()["name"], told.json()["email"]) == ("Former participant", None)
    assert told_of(api, "Ben Example") == []
    again = {"is_organizer": True, "role": "owner"}
    assert api.post(f"{path}/organizer", "organizer", json=again).status_code == 404


def test_who_registered_a_team_that_was_refused_stays_until_they_are_forgotten(
    site: "Api", person: Open
) -> None:
    with site.database.write() as session:
        switch_self_registration(session, True, actor="test")
    ada = person(site)
    ada.sign_in()
    wanted = {"id": "gamma", "name": "Gamma", "note": "Gamma group"}
    assert ada.post("/my/team/register", wanted, page="/my/team").status_code == 303
    assert site.post("/organizer/teams/gamma/refuse", "organizer", json=WHY).is_success
    (known,) = site.get("/organizer/people", "organizer").json()
    assert (known["name"], known["email"]) == ADA[:2]
    assert site.post(f"/organizer/people/{known['id']}/forget", "organizer", json=WHY).is_success
    assert told_of(site, *ADA) == []


def test_whoever_takes_a_role_or_forgets_is_told_which_tokens_work_on(
    api_on_both: "Api", browse: Browse
) -> None:
    """Such as a token that an organizer gave another team, without an end, on the last day."""
    api = api_on_both
    with api.database.write() as session:
        ben = welcome_person(session, Identity("https://id.example.org", "ben", "Ben Example")).id
        set_organizer(session, ben, OrganizerRole.OWNER, actor="test")
        beta = api.team_ids["beta"]
        text, door = issue_token(session, beta, "door", TEAM_SCOPES, actor=f"person:{ben}")
        api.tokens["door"], prefix = text, door.prefix
        link, _ = invite(session, beta, "an organizer", actor=f"person:{ben}")
    again = api.post("/tokens", "door", json={"name": "again"}).json()["view"]
    seen = {one["name"]: one["made_by"] for one in api.get("/tokens", "beta").json()}
    assert seen["door"] == "organizers", "who never was of the team is nobody it knows"
    owner = browse(api, who="organizer")
    page, path = f"/organize/people/{ben}", f"/organizer/people/{ben}"
    for shown in (page, f"{page}/forget"):
        assert f"<li>door (Beta), {prefix}</li>" in owner.get(shown).text
        assert f"<li>again (Beta), {again['prefix']}</li>" in owner.get(shown).text
    told = api.post(f"{path}/organizer", "organizer", json={"is_organizer": False}).json()
    assert {one["name"] for one in told["still_work"]} == {"door", "again"}
    with api.database.read() as session, pytest.raises(NotFound):
        find_invitation(session, link, None)
    for token in told["still_work"]:
        assert api.post(f"/organizer/tokens/{token['id']}/revoke", "organizer").is_success
    assert "Tokens that they made" not in owner.get(f"{page}/forget").text
    assert api.post(f"{path}/forget", "organizer", json=WHY).json()["still_work"] == []


def test_a_form_of_somebody_who_was_forgotten_meanwhile_adds_nobody(api_on_both: "Api") -> None:
    """Joining and registering look who signed in before they write."""
    api = api_on_both
    with api.database.write() as session:
        cy = welcome_person(session, Identity("https://id.example.org", "cy", "Cy Example")).id
        link, _ = invite(session, api.team_ids["alpha"], "somebody", actor="test")
    assert api.post(f"/organizer/people/{cy}/forget", "organizer", json=WHY).status_code == 200
    with pytest.raises(NotFound, match="no person"), api.database.write() as session:
        accept_invitation(session, link, cy, actor=f"person:{cy}")
    with api.database.read() as session:
        assert members_of(session, api.team_ids["alpha"]) == []
