"""Tokens: who may do what, and what a wrong one is told."""

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any

import pytest
from sqlalchemy import update

from exceptiondrive_records.accounts.tables import Token

if TYPE_CHECKING:
    from tests.support.application import Api

Problem = Callable[[Any, int, str], dict[str, Any]]
ORGANIZER_ROUTES = [
    ("GET", "/organizer/teams"),
    ("POST", "/organizer/teams"),
    ("GET", "/organizer/teams/alpha/tokens"),
    ("POST", "/organizer/teams/alpha/tokens"),
    ("POST", "/organizer/tokens/x/revoke"),
    ("GET", "/organizer/splits"),
    ("POST", "/organizer/phases"),
    ("POST", "/organizer/protocols"),
    ("GET", "/organizer/audit"),
    ("GET", "/organizer/audit/verify"),
]


def operations_of(api: "Api") -> list[tuple[str, str]]:
    return [
        (method.upper(), path.removeprefix("/api/v1"))
        for path, operations in api.app.openapi()["paths"].items()
        for method in operations
    ]


@pytest.mark.row("I23")
def test_a_participant_who_calls_every_organizer_route_is_told_403(
    api: "Api", as_problem: Problem
) -> None:
    called = [(m, p) for m, p in operations_of(api) if p.startswith("/organizer")]
    assert len(called) >= len(ORGANIZER_ROUTES)
    for method, path in called:
        filled = path.replace("{team_id}", "alpha").replace("{token_id}", "x")
        as_problem(api.request(method, filled, "alpha"), 403, "not_allowed")


@pytest.mark.parametrize(("method", "path"), ORGANIZER_ROUTES)
def test_a_stranger_who_calls_an_organizer_route_is_told_401(
    api: "Api", as_problem: Problem, method: str, path: str
) -> None:
    as_problem(api.request(method, path), 401, "not_signed_in")


@pytest.mark.row("I22")
def test_every_wrong_token_is_told_the_same(api_on_both: "Api", as_problem: Problem) -> None:
    api = api_on_both
    right = api.tokens["alpha"]
    api.tokens |= {
        "truncated": right[:-7],
        "altered": right[:20] + ("A" if right[20] != "A" else "B") + right[21:],
        "unknown": "edk_s_00000000_" + "A" * 32 + "_AAAAAA",
        "rubbish": "x" * 5000,
        "many parts": "_" * 50,
        "empty": "",
    }
    body = {"name": "old", "expires_at": (datetime.now(UTC) + timedelta(hours=1)).isoformat()}
    expired = api.post("/organizer/teams/alpha/tokens", "organizer", json=body).json()
    revoked = api.post("/organizer/teams/alpha/tokens", "organizer", json={"name": "lost"}).json()
    api.tokens |= {"expired": expired["token"], "revoked": revoked["token"]}
    assert api.get("/me", "expired").status_code == 200
    with api.database.write() as session:
        past = datetime.now(UTC) - timedelta(seconds=1)
        session.execute(
            update(Token).where(Token.id == expired["view"]["id"]).values(expires_at=past)
        )
    api.post(f"/organizer/tokens/{revoked['view']['id']}/revoke", "organizer")
    told = {
        as_problem(api.get("/me", who), 401, "not_signed_in")["detail"]
        for who in (
            "truncated",
            "altered",
            "unknown",
            "rubbish",
            "many parts",
            "expired",
            "revoked",
        )
    }
    assert len(told) == 1


def test_a_wrong_token_is_refused_where_none_is_needed_too(api: "Api", as_problem: Problem) -> None:
    api.tokens["wrong"] = "edk_wrong"
    as_problem(api.get("/phases", "wrong"), 401, "not_signed_in")


def test_a_token_is_taken_from_no_cookie_and_no_query(api: "Api", as_problem: Problem) -> None:
    token = api.tokens["alpha"]
    as_problem(api.get("/me", headers={"Cookie": f"token={token}"}), 401, "not_signed_in")
    as_problem(api.get("/me", params={"token": token}), 400, "bad_request")
    as_problem(api.get("/me", headers={"Authorization": f"Basic {token}"}), 401, "not_signed_in")


def test_no_token_stands_in_any_log_line(api: "Api", logs: list[Any]) -> None:
    api.submit("a")
    api.get("/me", "organizer", params={"token": api.tokens["alpha"]})
    api.tokens["wrong"] = "edk_s_00000000_" + "A" * 32 + "_AAAAAA"
    api.get("/me", "wrong")
    written = repr(logs)
    assert [line["route"] for line in logs if line["event"] == "request"][:2] == [
        "/api/v1/submissions",
        "/api/v1/me",
    ]
    for token in api.tokens.values():
        assert token not in written
