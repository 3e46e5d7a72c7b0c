"""Every error is an RFC 9457 problem with an id, the security headers, and nothing of the request."""

import json
import re
import subprocess
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest
from fastapi import Request

from exceptiondrive_records.db.errors import RecordsError
from exceptiondrive_schemas.api.problems import Problem as ProblemDocument
from exceptiondrive_schemas.api.problems import ProblemCode
from exceptiondrive_schemas.publish.written_files import settings_page
from exceptiondrive_server.web.problem_vocabulary import PROBLEMS

if TYPE_CHECKING:
    from tests.support.application import Api

Problem = Callable[[Any, int, str], dict[str, Any]]
SECRET = "48.858370N-2.294481E"


def test_every_code_has_a_status_and_a_title() -> None:
    assert set(PROBLEMS) == set(ProblemCode)


@pytest.mark.parametrize(
    ("body", "fields"),
    [
        ("null", {"body": "must be a JSON object"}),
        (
            '{"channel": "webhook", "address": "https://x.test/", "wishes": 1}',
            {"wishes": "must be a list"},
        ),
    ],
)
def test_a_wrong_body_is_told_in_words_of_json(
    api: "Api", body: str, fields: dict[str, str]
) -> None:
    headers = {**api.headers("alpha"), "Content-Type": "application/json"}
    answer = api.client.post("/api/v1/contacts", headers=headers, content=body)
    assert (answer.status_code, answer.json()["fields"]) == (400, fields)


@pytest.mark.parametrize("called", ["application/x-www-form-urlencoded", "text/plain", None])
def test_json_that_is_not_called_json_is_told_so(
    api: "Api", as_problem: Problem, called: str | None
) -> None:
    headers = api.headers("alpha") | ({} if called is None else {"Content-Type": called})
    answer = api.client.post("/api/v1/contacts", headers=headers, content="{}")
    problem = as_problem(answer, 415, "unsupported_media_type")
    assert "Content-Type: application/json" in problem["detail"]


def test_a_body_of_another_form_than_its_headers_say_is_told_so(
    api: "Api", as_problem: Problem
) -> None:
    headers = {**api.headers("alpha"), "Content-Type": "application/json"}
    answer = api.client.post("/api/v1/contacts", headers=headers, content=b"\xff{}")
    problem = as_problem(answer, 400, "bad_request")
    assert problem["detail"].startswith("The body cannot be read")


def test_an_unknown_address_is_404(api: "Api", as_problem: Problem) -> None:
    problem = as_problem(api.get("/nothing/here"), 404, "not_found")
    assert ProblemDocument.model_validate_json(json.dumps(problem)).code == "not_found"


@pytest.mark.parametrize("method", ["PUT", "DELETE", "PATCH", "OPTIONS", "BREW"])
def test_another_method_is_405_and_names_those_that_are_taken(
    api: "Api", as_problem: Problem, method: str
) -> None:
    response = api.request(method, "/phases")
    as_problem(response, 405, "method_not_allowed")
    assert response.headers["allow"] == "GET, HEAD"
    assert method not in response.json()["detail"]


@pytest.mark.parametrize(
    "address",
    [
        "/leaderboard?phase=dev&as_off=2020-01-01",  # reads its address itself
        "/leaderboard.csv?phase=dev&hide=ur",  # of the page alone
        "/leaderboard/facts?phase=dev&hide=ur",
        "/boards/dev/1?number=2",
        "/splits/sample?revison=abc",
        "/entries/abc?protcol=1.0",
        "/submissions?statuss=scored",
        "/organizer/audit?actr=x",
    ],
)
def test_an_unknown_parameter_is_refused_and_not_passed_over(
    api: "Api", as_problem: Problem, address: str
) -> None:
    answer = api.get(address, "organizer" if "organizer" in address else "alpha")
    name = address.rpartition("=")[0].replace("?", "&").rpartition("&")[2]
    problem = as_problem(answer, 400, "bad_request")
    assert problem["fields"] == {name: "There is no such field; leave it out."}


def test_a_page_passes_over_what_links_from_elsewhere_carry(api: "Api") -> None:
    assert api.client.get("/protocols?utm_source=mail").status_code == 200


@pytest.mark.parametrize("name", ["rules", "closing_date"])
def test_an_unknown_field_is_named_where_its_name_is_plain(
    api: "Api", as_problem: Problem, name: str
) -> None:
    answer = api.request("PATCH", "/organizer/phases/dev", "organizer", json={name: "x"})
    problem = as_problem(answer, 400, "bad_request")
    assert problem["fields"] == {name: "There is no such field; leave it out."}
    assert name in problem["detail"]


@pytest.mark.parametrize("name", ["<b>x</b>", SECRET, "a" * 41, "edk_s_1A2b3C4d", "x y", ""])
def test_no_other_name_of_an_unknown_field_is_repeated(
    api: "Api", as_problem: Problem, name: str
) -> None:
    answer = api.request("PATCH", "/organizer/phases/dev", "organizer", json={name: "x"})
    assert list(as_problem(answer, 400, "bad_request")["fields"]) == ["(unknown field)"]
    assert not name or name not in answer.text


def test_what_the_settings_of_a_phase_are_said_to_stand_under_is_taken(api: "Api") -> None:
    """The example and the column of docs/phase-settings.md."""
    text = settings_page()
    example = re.search('`({"title".+})`', text)
    assert example is not None
    row = r"^\| `(\w+)` \| (?:`(\w+)`)? \| .+ \| empty \| .+ \|$"
    texts = re.findall(row, text, re.MULTILINE)
    assert {part for _, part in texts} == {"", "page"}
    for body in (
        json.loads(example[1]),
        *({part: {name: ""}} if part else {name: ""} for name, part in texts),
    ):
        taken = api.request("PATCH", "/organizer/phases/dev", "organizer", json=body)
        assert taken.status_code == 200, (body, taken.text)


def test_every_answer_carries_the_security_headers(api: "Api") -> None:
    answers = [api.get(path) for path in ("/phases", "/nothing", "/me", "/healthz", "/metrics")]
    for response in answers:
        policy = response.headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "frame-ancestors 'none'" in policy
        assert "unsafe" not in policy
        assert response.headers["x-content-type-options"] == "nosniff"
        assert response.headers["referrer-policy"] == "no-referrer"
        assert response.headers["cache-control"]


def test_a_personal_answer_is_kept_by_no_cache(api: "Api") -> None:
    for path in ("/me", "/phases", "/submissions"):
        assert api.get(path, "alpha").headers["cache-control"] == "no-store"


def test_what_is_not_there_takes_its_place_in_the_proxy(api: "Api") -> None:
    """What stood there before it was hidden would be shown again while no server answers."""
    for path in ("/phases/none", "/entries/none"):
        told = api.get(path).headers
        assert (told["x-accel-expires"], told["cache-control"]) == ("5", "no-store")
        assert list(told).index("x-accel-expires") < list(told).index("cache-control")
    page = api.client.get("/phases/none", headers={"Accept": "text/html"})
    assert (page.status_code, page.headers["x-accel-expires"]) == (404, "5")
    assert "x-accel-expires" not in api.get("/me").headers


def test_a_plain_request_id_is_taken_over_and_a_strange_one_replaced(api: "Api") -> None:
    def answered(offered: str) -> str:
        response = api.get("/phases", headers={"X-Request-ID": offered})
        return str(response.headers["x-request-id"])

    assert answered("proxy-2026.11.21_1") == "proxy-2026.11.21_1"
    for strange in ("short", "x" * 65, "<script>alert(1)</script>", "a b c d e f", ""):
        assert answered(strange) != strange


def test_our_own_error_is_500_with_an_id_and_nothing_else(
    api: "Api", as_problem: Problem, logs: list[Any]
) -> None:
    @api.app.get("/api/v1/broken")
    def broken() -> None:
        raise ZeroDivisionError(SECRET)

    response = api.get("/broken")
    problem = as_problem(response, 500, "internal")
    assert problem["request_id"] in problem["detail"]
    assert SECRET not in response.text
    assert "ZeroDivision" not in response.text
    assert "frame-ancestors 'none'" in response.headers["content-security-policy"]
    assert SECRET not in repr(logs)
    assert [line["status"] for line in logs if line["event"] == "request"] == [500]
    (told,) = [line for line in logs if line["event"] == "unexpected error"]
    assert (told["kind"], told["request_id"]) == ("ZeroDivisionError", problem["request_id"])
    assert (
        "Operators find it in the logs by the request id"
        in api.client.get("/problems/internal").text
    )
    assert told["places"][-1].endswith(" broken")


def test_the_log_says_of_an_error_its_kind_and_places_and_none_of_its_words() -> None:
    """uvicorn wrote the whole traceback: words of errors quote what was sent."""
    code = (
        "import logging\nimport sys\nimport structlog\n"
        "from exceptiondrive_records.operations.logs import set_up_logs\nset_up_logs(sys.stdout)\n"
        "def fails() -> None:\n    raise ValueError('hush')\n"
        "try:\n    fails()\nexcept ValueError:\n"
        "    logging.getLogger('uvicorn.error').exception('Exception in the application')\n"
        "    structlog.get_logger().exception('ours')\n"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    lines = [json.loads(line) for line in run.stdout.splitlines()]
    assert [line["event"] for line in lines] == ["Exception in the application", "ours"]
    assert {line["kind"] for line in lines} == {"ValueError"}
    assert all(line["places"][-1].endswith(" fails") for line in lines)
    assert ("hush" in run.stdout, run.stderr) == (False, "")


def test_an_error_of_the_records_without_a_status_of_its_own_is_400(
    api: "Api", as_problem: Problem
) -> None:
    @api.app.get("/api/v1/refused")
    def refused(request: Request) -> None:
        raise RecordsError("A sentence for the reader.")

    problem = as_problem(api.get("/refused"), 400, "bad_request")
    assert problem["detail"] == "A sentence for the reader."


def test_an_answer_to_an_invalid_request_is_short_and_repeats_nothing(
    api: "Api", as_problem: Problem
) -> None:
    body = {f"{SECRET}-{number}": SECRET for number in range(5_000)}
    response = api.post("/organizer/teams", "organizer", json=body)
    problem = as_problem(response, 400, "bad_request")
    assert len(response.content) < 16_000
    assert len(problem["fields"]) <= 20
    assert SECRET not in response.text


def test_an_invalid_value_is_not_repeated(api: "Api", as_problem: Problem) -> None:
    for query in (f"limit={SECRET}", f"status={SECRET}"):
        response = api.get(f"/submissions?{query}", "alpha")
        as_problem(response, 400, "bad_request")
        assert SECRET not in response.text
    response = api.get(f"/leaderboard?as_of={SECRET}&challenge={SECRET}")
    as_problem(response, 400, "bad_request")
    assert SECRET not in response.text


def test_addresses_stay_out_of_the_log(api: "Api", logs: list[Any]) -> None:
    api.get(f"/entries/{SECRET}", params={"token": SECRET})
    api.get(f"/{SECRET}")
    assert [line["route"] for line in logs] == ["/api/v1/entries/{submission_id}", "unmatched"]
    assert SECRET not in repr(logs)


def test_nothing_is_redirected_to_another_host(api: "Api") -> None:
    response = api.get("/phases/", headers={"Host": "evil.example"}, follow_redirects=False)
    assert response.status_code == 404
    assert "evil" not in repr(response.headers)
