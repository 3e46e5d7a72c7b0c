"""Everything under /organizer."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest
from sqlalchemy import text, update

from exceptiondrive_records.audit.tables import AuditLine
from exceptiondrive_schemas.api.submission import PhaseView
from exceptiondrive_schemas.protocol import packaged_protocol_toml

if TYPE_CHECKING:
    from tests.support.application import Api

Problem = Callable[[Any, int, str], dict[str, Any]]
LONE = b'{"id": "x", "name": "\\ud800"}'
"""A lone surrogate, which no database holds."""
PHASE = {
    "id": "final",
    "challenge": "planning",
    "title": "Final",
    "split": "sample",
    "protocol": "1.0",
}


def post(api: "Api", path: str, body: Any) -> Any:
    return api.post(f"/organizer/{path}", "organizer", json=body)


def post_protocol(api: "Api", toml: str | bytes) -> Any:
    headers = {"Content-Type": "application/toml"}
    return api.post("/organizer/protocols", "organizer", content=toml, headers=headers)


def test_a_team_is_made_listed_and_made_once(api_on_both: "Api", as_problem: Problem) -> None:
    made = post(api_on_both, "teams", {"id": "gamma", "name": "Gamma", "is_reference": True})
    assert made.status_code == 201
    listed = api_on_both.get("/organizer/teams", "organizer").json()
    assert [team["id"] for team in listed] == ["alpha", "beta", "gamma"]
    assert listed[-1] == made.json()
    as_problem(post(api_on_both, "teams", {"id": "gamma", "name": "G"}), 409, "conflict")


@pytest.mark.parametrize(
    "body",
    [
        {"id": "Capital", "name": "x"},
        {"id": "a b", "name": "x"},
        {"id": "x", "name": ""},
        {"id": "x", "name": "nul\u0000"},
        {"id": "x"},
        {"id": "x", "name": "y", "extra": 1},
        {"id": "x", "name": "y", "is_reference": "yes"},
        [],
        "x",
        None,
    ],
)
def test_a_team_that_cannot_be_is_refused(
    api_on_both: "Api", as_problem: Problem, body: Any
) -> None:
    as_problem(post(api_on_both, "teams", body), 400, "bad_request")


def test_what_is_not_json_is_refused(api: "Api", as_problem: Problem) -> None:
    headers = {"Content-Type": "application/json"}
    for body in (b"{", b"[" * 100_000, b"\xff\xfe", b'{"id": 1e999}', LONE):
        response = api.post("/organizer/teams", "organizer", content=body, headers=headers)
        as_problem(response, 400, "bad_request")


def test_a_token_is_shown_once_works_and_can_be_revoked(
    api_on_both: "Api", as_problem: Problem
) -> None:
    issued = post(api_on_both, "teams/alpha/tokens", {"name": "desk"})
    assert issued.status_code == 201
    assert issued.headers["cache-control"] == "no-store"
    token, view = issued.json()["token"], issued.json()["view"]
    assert token.startswith(view["prefix"])
    listed = api_on_both.get("/organizer/teams/alpha/tokens", "organizer")
    assert view["id"] in [row["id"] for row in listed.json()]
    assert token not in listed.text
    api_on_both.tokens["desk"] = token
    assert api_on_both.get("/me", "desk").json()["team"] == "Alpha"
    assert post(api_on_both, f"tokens/{view['id']}/revoke", None).status_code == 200
    as_problem(api_on_both.get("/me", "desk"), 401, "not_signed_in")
    as_problem(post(api_on_both, f"tokens/{view['id']}/revoke", None), 409, "conflict")


@pytest.mark.parametrize(
    "body",
    [
        {"name": "x", "scopes": ["everything"]},
        {"name": "x", "scopes": []},
        {"name": "x", "expires_at": "2001-01-01T00:00:00Z"},
        {"name": "x", "expires_at": "2101-01-01T00:00:00"},
        {"name": "x", "expires_at": 4133980800},
    ],
)
def test_a_token_that_cannot_be_is_refused(api: "Api", as_problem: Problem, body: Any) -> None:
    as_problem(post(api, "teams/alpha/tokens", body), 400, "bad_request")


def test_a_token_for_an_unknown_team_is_404(api: "Api", as_problem: Problem) -> None:
    as_problem(post(api, "teams/nobody/tokens", {"name": "x"}), 404, "not_found")


def test_a_phase_is_made_with_its_dates_and_limits(api_on_both: "Api") -> None:
    dates = {"opens_at": "2026-01-01T00:00:00Z", "closes_at": "2099-01-01T00:00:00+02:00"}
    made = post(api_on_both, "phases", {**PHASE, **dates, "quota_total": 9})
    assert made.status_code == 201, made.text
    phase = PhaseView.model_validate_json(made.content)
    assert phase.is_open
    assert phase.quota_total == 9
    assert api_on_both.get("/phases/final").json() == made.json()


@pytest.mark.parametrize(
    ("changes", "status", "code"),
    [
        ({"id": "dev"}, 409, "conflict"),
        ({"split": "nothing"}, 404, "not_found"),
        ({"protocol": "9.9"}, 404, "not_found"),
        ({"challenge": "tracking"}, 400, "bad_request"),
        ({"quota_per_day": 0}, 400, "bad_request"),
        ({"quota_per_day": "3"}, 400, "bad_request"),
        ({"opens_at": "2027-01-01T00:00:00Z", "closes_at": "2026-01-01T00:00:00Z"}, 400,
         "bad_request"),
        ({"opens_at": "0001-01-01T00:00:00+14:00"}, 400, "bad_request"),
        ({"title": "two\nlines"}, 400, "bad_request"),
        ({"surprise": True}, 400, "bad_request"),
    ],
)  # fmt: skip
def test_a_phase_that_cannot_be_is_refused(
    api: "Api", as_problem: Problem, changes: Any, status: int, code: str
) -> None:
    as_problem(post(api, "phases", {**PHASE, **changes}), status, code)


def test_splits_are_listed_for_a_phase_to_use(api: "Api") -> None:
    (split,) = api.get("/organizer/splits", "organizer").json()
    assert (split["name"], split["n_samples"], split["is_public"]) == ("sample", 3, False)


def test_a_protocol_is_added_once(api_on_both: "Api", as_problem: Problem) -> None:
    toml = packaged_protocol_toml().replace('version = "1.0"', 'version = "1.1"')
    made = post_protocol(api_on_both, toml)
    assert made.status_code == 201, made.text
    assert post_protocol(api_on_both, toml).status_code == 200
    versions = [
        row["version"] for row in api_on_both.get("/organizer/protocols", "organizer").json()
    ]
    assert versions == ["1.0", "1.1"]
    other = toml.replace("bootstrap_draws = 1000", "bootstrap_draws = 2000")
    problem = as_problem(post_protocol(api_on_both, other), 409, "conflict")
    assert "new version" in problem["detail"]


def test_every_fault_of_a_protocol_is_named(api: "Api", as_problem: Problem) -> None:
    toml = (
        packaged_protocol_toml()
        .replace("waypoints = 6", 'waypoints = "six"')
        .replace("min_coverage = 0.99", "min_coverage = 99")
    )
    detail = as_problem(post_protocol(api, toml), 400, "bad_request")["detail"]
    assert "geometry.waypoints" in detail
    assert "ranking.min_coverage" in detail


@pytest.mark.parametrize(
    "toml",
    ["", "schema = ", "x = nan", "x = 2026-01-01", b"\xff\xfe", b"\x00", "a = " + "[" * 50_000],
    ids=["empty", "cut", "nan", "date", "not UTF-8", "NUL", "deep"],
)
def test_what_is_no_protocol_is_refused(api: "Api", as_problem: Problem, toml: str | bytes) -> None:
    as_problem(post_protocol(api, toml), 400, "bad_request")


def test_a_huge_protocol_is_refused(api: "Api", as_problem: Problem) -> None:
    as_problem(post_protocol(api, "#" * 300_000), 400, "bad_request")
    as_problem(post_protocol(api, "#" * 2_000_000), 413, "upload_too_large")


def test_every_change_leaves_an_audit_line_and_the_chain_is_whole(api_on_both: "Api") -> None:
    api = api_on_both
    post(api, "teams", {"id": "gamma", "name": "Gamma"})
    (line,) = api.get("/organizer/audit?limit=1", "organizer").json()
    assert (line["action"], line["subject"]) == ("team created", "gamma")
    assert line["actor"].startswith("token:")
    older = api.get(f"/organizer/audit?before={line['id']}&limit=500", "organizer").json()
    assert [row["id"] for row in older] == list(range(line["id"] - 1, 0, -1))
    verdict = api.get("/organizer/audit/verify", "organizer").json()
    assert verdict == {
        "is_whole": True, "n_lines": line["id"], "head": line["hash"], "broken_at": None,
        "holds_kept_head": None,
    }  # fmt: skip
    for head, is_held in ((older[-1]["hash"], True), ("f" * 64, False)):
        seen = api.get(f"/organizer/audit/verify?head={head}", "organizer").json()
        assert (seen["is_whole"], seen["holds_kept_head"]) == (True, is_held)
    assert api.get("/organizer/audit/verify?head=" + "f" * 63, "organizer").status_code == 400
    wrong = api.get("/organizer/audit/verify?head=abc", "organizer")
    words = "must be the head that an earlier verification told: 64 digits 0-9 and a-f"
    assert (wrong.status_code, wrong.json()["fields"]) == (400, {"head": words})


def test_an_altered_audit_line_is_found(api: "Api") -> None:
    with api.database.write() as session:
        session.execute(text("DROP TRIGGER audit_lines_no_update"))  # as one who owns the file
        session.execute(update(AuditLine).where(AuditLine.id == 2).values(actor="nobody"))
    verdict = api.get("/organizer/audit/verify", "organizer").json()
    assert (verdict["is_whole"], verdict["broken_at"]) == (False, 2)


def test_no_secret_stands_in_the_audit_log(api: "Api") -> None:
    log = api.get("/organizer/audit?limit=500", "organizer").text
    for token in api.tokens.values():
        assert token[-39:] not in log
