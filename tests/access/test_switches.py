"""What organizers and operators switch while the server runs."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest
from typer.testing import CliRunner

from exceptiondrive_records.accounts.people import Identity, welcome_person
from exceptiondrive_server.operations.cli import app

if TYPE_CHECKING:
    from tests.support.application import Api

WANTED = {"id": "gamma", "name": "Gamma", "note": "Gamma group"}
SWITCH = "/organizer/self-registration"


def switched(api: "Api", is_on: bool) -> Any:
    return api.post(SWITCH, "organizer", json={"is_on": is_on}).json()


@pytest.mark.parametrize("environment", [None, True])
def test_organizers_switch_self_registration_while_the_server_runs(
    make_api: Callable[..., "Api"], database_url: str, environment: bool | None
) -> None:
    api = make_api(database_url, self_registration=environment)
    assert api.get(SWITCH, "organizer").json()["is_on"] is (environment is True)
    assert switched(api, True) == {"is_on": True, "is_forced_off": False}
    assert api.post("/registrations", json=WANTED).status_code == 201
    assert switched(api, False)["is_on"] is False
    refused = api.post("/registrations", json={**WANTED, "id": "delta", "name": "Delta"})
    assert refused.status_code == 403
    lines = [line["action"] for line in api.get("/organizer/audit", "organizer").json()]
    assert lines.count("self-registration switched") == 2


def test_the_environment_may_force_it_off(make_api: Callable[..., "Api"], sqlite_url: str) -> None:
    api = make_api(sqlite_url, self_registration=False)
    assert switched(api, True) == {"is_on": False, "is_forced_off": True}
    assert api.post("/registrations", json=WANTED).status_code == 403


def test_teams_switch_nothing(api: "Api") -> None:
    assert api.post(SWITCH, "alpha", json={"is_on": True}).status_code == 403
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


def test_operators_do_the_same_by_command(
    api: "Api", sqlite_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("EXCEPTIONDRIVE_DATABASE_URL", sqlite_url)
    run = CliRunner()
    assert run.invoke(app, ["self-registration", "on"]).exit_code == 0
    assert api.post("/registrations", json=WANTED).status_code == 201
