"""POST /registrations and POST /organizer/teams/{id}/approve."""

import socket
from collections.abc import Callable
from datetime import timedelta
from typing import TYPE_CHECKING, Any

import pytest
from tests.support.serving import served

from exceptiondrive_records.db.database import Database
from exceptiondrive_records.db.errors import Conflict
from exceptiondrive_records.participation.changes import approve_team
from exceptiondrive_records.teams.teams import find_team, list_teams, register_team

if TYPE_CHECKING:
    from tests.support.application import Api

Problem = Callable[[Any, int, str], dict[str, Any]]
WANTED = {"id": "gamma", "name": "Gamma", "note": "Gamma group, gamma@example.org"}


@pytest.fixture
def open_api(make_api: Callable[..., "Api"], database_url: str) -> "Api":
    """The application with registration switched on, on SQLite, then on PostgreSQL."""
    return make_api(database_url, self_registration=True)


def test_nobody_registers_where_it_is_not_switched_on(api: "Api", as_problem: Problem) -> None:
    as_problem(api.post("/registrations", json=WANTED), 403, "not_allowed")
    assert "gamma" not in api.get("/organizer/teams", "organizer").text


def test_a_registered_team_submits_only_when_it_is_approved(
    open_api: "Api", as_problem: Problem
) -> None:
    api = open_api
    made = api.post("/registrations", json=WANTED)
    assert made.status_code == 201
    assert not made.json()["is_approved"]
    api.tokens["gamma"] = made.json()["token"]
    assert api.get("/me", "gamma").json()["team"] == "Gamma"
    as_problem(api.submit("a", "gamma"), 403, "not_allowed")
    waiting = [
        team["registration_note"]
        for team in api.get("/organizer/teams", "organizer").json()
        if team["pending_since"]
    ]
    assert waiting == [WANTED["note"]]
    as_problem(api.post("/organizer/teams/gamma/approve", "gamma"), 403, "not_allowed")
    for _ in range(2):
        approved = api.post("/organizer/teams/gamma/approve", "organizer")
        assert approved.json()["pending_since"] is None
    assert api.submit("a", "gamma").status_code == 202
    lines = api.get("/organizer/audit", "organizer").json()
    assert [line["action"] for line in lines].count("team approved") == 1
    (told,) = api.get("/notifications", "gamma").json()
    assert told["title"] == "Your team Gamma is approved"


def test_an_upload_of_a_team_that_waits_for_approval_is_refused_at_its_head(
    open_api: "Api",
) -> None:
    """Strangers who registered eight teams held all 32 places of a server, sending nothing more."""
    token = open_api.post("/registrations", json=WANTED).json()["token"]
    head = (
        "POST /api/v1/submissions HTTP/1.1\r\nHost: x\r\nContent-Length: 60000\r\n"
        f"Authorization: Bearer {token}\r\nContent-Type: multipart/form-data; boundary=b\r\n\r\n"
    )
    with served(open_api.app) as address:
        place = ("127.0.0.1", int(address.rpartition(":")[2]))
        with socket.create_connection(place, timeout=60) as stranger:
            stranger.sendall(head.encode())
            answer = stranger.recv(65_536)
    assert answer.startswith(b"HTTP/1.1 403 ")
    assert b"not approved yet" in answer
    assert open_api.services.upload_places.taken == 0


def test_a_team_that_waits_for_approval_asks_one_question_at_a_time(
    open_api: "Api", as_problem: Problem
) -> None:
    api = open_api
    api.tokens["gamma"] = api.post("/registrations", json=WANTED).json()["token"]

    def ask(words: str) -> Any:
        return api.post("/phases/dev/questions", "gamma", json={"text": words})

    assert ask("When are we approved?").status_code == 201
    assert "waits" in as_problem(ask("And now?"), 409, "conflict")["detail"]
    api.post("/organizer/teams/gamma/approve", "organizer")
    assert ask("And now?").status_code == 201


def test_a_taken_name_and_a_team_that_is_not_there_are_told(
    open_api: "Api", as_problem: Problem
) -> None:
    as_problem(open_api.post("/registrations", json={**WANTED, "id": "alpha"}), 409, "conflict")
    as_problem(open_api.post("/organizer/teams/nobody/approve", "organizer"), 404, "not_found")


def test_one_network_takes_few_places_and_a_place_lasts_three_days(database: Database) -> None:
    """Forty addresses of one network filled all 200 places within seconds."""

    def register(number: int, address: str) -> None:
        with database.write() as session:
            register_team(session, f"team-{number}", f"Team {number}", "note", address=address)

    for number in range(20):
        register(number, f"203.0.{number}.7")
    with pytest.raises(Conflict, match="of your network"):
        register(20, "203.0.113.200")
    with pytest.raises(Conflict, match="of your network"):
        register(21, "::ffff:203.0.113.9")
    for number in range(22, 202):
        register(number, f"{number}.0.0.1")
    with pytest.raises(Conflict, match="Too many teams wait"):
        register(202, "2001:db8::1")
    with database.write() as session:
        for team in list_teams(session):
            team.pending_since = team.created_at - timedelta(days=4)
    register(203, "203.0.113.200")
    with database.read() as session:
        assert len([team for team in list_teams(session) if team.pending_since]) == 201
        assert find_team(session, "team-203").registered_from is not None
    with database.write() as session:
        approved = approve_team(session, "team-203", actor="test")
        assert approved.registered_from is None, "it is kept as long as it counts"


def test_one_address_registers_a_few_teams_in_a_while(
    make_api: Callable[..., "Api"], sqlite_url: str, as_problem: Problem
) -> None:
    api = make_api(sqlite_url, self_registration=True)
    for number in range(5):
        wanted = {**WANTED, "id": f"team-{number}", "name": f"Team {number}"}
        assert api.post("/registrations", json=wanted).status_code == 201
    answer = api.post("/registrations", json=WANTED)
    as_problem(answer, 429, "too_many_requests")
    assert int(answer.headers["retry-after"]) > 0
