"""What operators and organizers switch while the server runs."""

from collections.abc import Callable
from typing import TYPE_CHECKING

import pytest
from typer.testing import CliRunner

from exceptiondrive_records.accounts.people import Identity, welcome_person
from exceptiondrive_records.teams.teams import switch_self_registration
from exceptiondrive_server.operations.cli import app

if TYPE_CHECKING:
    from tests.support.application import Api

WANTED = {"id": "gamma", "name": "Gamma", "note": "Gamma group"}


@pytest.mark.parametrize("environment", [None, True])
def test_operators_switch_self_registration_while_the_server_runs(
    make_api: Callable[..., "Api"],
    database_url: str,
    environment: bool | None,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    api, command = make_api(database_url, self_registration=environment), CliRunner()
    monkeypatch.setenv("EXCEPTIONDRIVE_DATABASE_URL", database_url)
    before = api.post("/registrations", json={**WANTED, "id": "beyond", "name": "Beyond"})
    assert before.status_code == (201 if environment else 403)
    assert command.invoke(app, ["self-registration", "on"]).exit_code == 0
    assert api.post("/registrations", json=WANTED).status_code == 201
    assert command.invoke(app, ["self-registration", "off"]).exit_code == 0
    refused = api.post("/registrations", json={**WANTED, "id": "delta", "name": "Delta"})
    assert refused.status_code == 403
    lines = [line["action"] for line in api.get("/organizer/audit", "organizer").json()]
    assert lines.count("self-registration switched") == 2


def test_the_environment_may_force_it_off(make_api: Callable[..., "Api"], sqlite_url: str) -> None:
    api = make_api(sqlite_url, self_registration=False)
    with api.database.write() as session:
        switch_self_registration(session, True, actor="test")
    assert api.post("/registrations", json=WANTED).status_code == 403


def test_teams_invite_to_no_other_team(api: "Api") -> None:
    assert api.post("/organizer/teams/beta/invitations", "alpha").status_code == 403


def test_organizers_name_organizers_and_invite(api: "Api") -> None:
    with api.database.write() as session:
        person_id = welcome_person(session, Identity("https://issuer.example", "s", "Ada")).id
    path = f"/organizer/people/{person_id}/organizer"
    assert api.post(path, "organizer", json={"is_organizer": True}).json()["is_organizer"] is True
    (ada,) = api.get("/organizer/people", "organizer").json()
    assert (ada["name"], ada["is_organizer"]) == ("Ada", True)
    assert "issuer" not in ada
    missing = api.post("/organizer/people/x/organizer", "organizer", json={"is_organizer": True})
    assert missing.status_code == 404
    made = api.post("/organizer/teams/alpha/invitations", "organizer")
    assert made.status_code == 201
    assert made.json()["path"].startswith("/join/")
