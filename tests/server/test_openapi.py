"""The OpenAPI document, and the API held to it by generated requests (schemathesis)."""

import html
import json
import re
from collections import Counter
from collections.abc import Callable, Iterator
from itertools import product
from typing import TYPE_CHECKING, Any

import pytest
import schemathesis
from hypothesis import HealthCheck, given, settings, strategies
from jsonschema import Draft202012Validator
from schemathesis import APIOperation, Case, CheckContext, GenerationMode, SerializationContext
from schemathesis.checks import CHECKS as ALL_CHECKS
from schemathesis.checks import load_all_checks
from schemathesis.core.parameters import ParameterLocation
from schemathesis.core.result import Ok
from schemathesis.specs.openapi.checks import (
    negative_data_rejection,
    positive_data_acceptance,
)

from exceptiondrive_records.accounts.tokens import (
    ORGANIZER_SCOPES,
    TEAM_SCOPES,
    issue_token,
)
from exceptiondrive_records.notifications.channels import SIGNATURE_HEADER, TIMESTAMP_HEADER
from exceptiondrive_schemas.api.problems import ProblemCode
from exceptiondrive_schemas.board import Board
from exceptiondrive_schemas.challenges import PLANNING
from exceptiondrive_server.guide.operations import METHODS
from exceptiondrive_server.guide.operations import operations as by_tag
from exceptiondrive_server.web.problem_vocabulary import PROBLEMS

if TYPE_CHECKING:
    from tests.support.application import Api

HELD_BACK = re.compile(r"hidden(?!_until)|region|clearance_m|scene_id")


def operations(document: dict[str, Any]) -> list[tuple[str, str, dict[str, Any]]]:
    return [
        (path, method, operation)
        for path, methods in document["paths"].items()
        for method, operation in methods.items()
    ]


def test_the_document_is_served_and_names_every_operation_once(api: "Api") -> None:
    document = api.get("/openapi.json").json()
    assert document["openapi"].startswith("3.1")
    names = [operation["operationId"] for _, _, operation in operations(document)]
    assert len(names) == len(set(names)) >= 30
    assert all(re.fullmatch(r"[a-z][A-Za-z]+", name) for name in names)


def test_the_names_that_clients_rely_on_stay(api: "Api") -> None:
    names = {operation["operationId"] for _, _, operation in operations(api.app.openapi())}
    assert names >= {
        "listPhases", "showPhase", "showManifest", "downloadSplit", "submit", "listSubmissions",
        "showSubmission", "followSubmission", "withdrawSubmission", "showBoard", "downloadBoard",
        "showBoardByNumber", "showEntry", "listProtocols", "showProtocol", "listTasks",
        "listSchemas", "showSchema", "showExample", "whoAmI", "createTeam", "issueToken",
        "createPhase", "addProtocol", "readAudit", "verifyAudit",
    }  # fmt: skip


def test_every_error_is_documented_as_a_problem_and_422_is_not(api: "Api") -> None:
    for path, method, operation in operations(api.app.openapi()):
        responses = operation["responses"]
        assert "default" in responses, (method, path)
        assert "422" not in responses, (method, path)
        for status, response in responses.items():
            if status == "default" or (status >= "400" and path != "/readyz"):
                assert list(response["content"]) == ["application/problem+json"], (path, status)


def test_the_api_page_says_what_each_operation_takes_and_answers(api: "Api") -> None:
    description = api.app.openapi()
    text = api.client.get("/api").text
    told = [one for group in by_tag(description).values() for one in group]
    n = sum(len(set(item) & set(METHODS)) for item in description["paths"].values())
    assert len(told) == n == text.count("<details id=")
    assert len({one.anchor for one in told}) == n
    board = next(one for one in told if one.path == "/api/v1/leaderboard")
    sort = next(each for each in board.asks if each.name == "sort")
    assert (sort.where, sort.is_required, sort.type_words) == ("query", False, "string, else rank")
    assert board.schema == "Board"
    assert {"board", "limit", "after"} <= {each.name for each in board.asks}
    assert {"entries", "families"} <= {each.name for each in board.answers}
    shown = Board.model_validate_json(board.sample)
    assert (len(shown.entries), shown.challenge) == (1, PLANNING.id)
    assert '"rank_interval"' in html.unescape(text)
    upload = next(one for one in told if (one.method, one.path) == ("POST", "/api/v1/submissions"))
    assert upload.takes_token
    assert upload.needs_token
    assert upload.status == "200 or 202"
    assert "differ from it, they are refused (409)" in " ".join(upload.paragraphs)
    assert "or in another phase, is refused (409)" in " ".join(upload.paragraphs)
    phases = next(one for one in told if (one.method, one.path) == ("GET", "/api/v1/phases"))
    assert (phases.takes_token, phases.needs_token) == (True, False)
    assert (board.takes_token, board.needs_token) == (False, False)
    quota = next(each for each in phases.answers if each.name == "quota_per_day")
    assert quota.type_words == "integer, at least 1, at most 10000, else 3"
    assert ("file", "body", True) in {(it.name, it.where, it.is_required) for it in upload.asks}
    assert "quota_exceeded" in upload.problems
    assert all(set(one.problems) <= set(ProblemCode) for one in told)
    listed = next(one for one in told if one.path == "/api/v1/boards")
    assert listed.schema == "list of BoardHistoryLine"


def test_every_operation_and_parameter_says_what_it_does_and_belongs_somewhere(api: "Api") -> None:
    document = api.app.openapi()
    tags = {tag["name"] for tag in document["tags"]}
    for path, method, operation in operations(document):
        assert operation["description"], (method, path)
        assert set(operation["tags"]) <= tags, f"describe the tag of {path} in openapi.TAGS"
        for asked in operation.get("parameters", ()):
            assert asked["in"] == "path" or asked.get("description"), (method, path, asked["name"])


def test_what_the_code_says_under_a_field_stands_in_the_document(api: "Api") -> None:
    schemas = api.app.openapi()["components"]["schemas"]

    def words(name: str, field: str) -> str:
        return str(schemas[name]["properties"][field].get("description", ""))

    assert words("SubmissionView", "is_duplicate").startswith("The same bytes were there before")
    assert "report.to_confirm" in schemas["SubmissionStatus"]["description"]
    assert "confirmed_bytes" not in words("Confirmation", "signature") != ""
    assert words("Problem", "resets_at") == "When a spent quota begins anew."
    assert words("RevokedToken", "made_by") == words("TokenView", "made_by") != ""
    assert words("PhaseView", "visibility").startswith("Shown to everybody")
    of_fields = [
        property_.get("description", "")
        for schema in schemas.values()
        for property_ in schema.get("properties", {}).values()
    ]
    assert sum(map(bool, of_fields)) > 200
    assert not [words for words in of_fields if "None" in words or "\n" in words]


def named_in(node: Any, document: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """The schemas that a part of the document names, and those that these name."""
    schemas, found, new = document["components"]["schemas"], dict[str, Any](), node
    while names := set(re.findall('#/components/schemas/([^"]+)', json.dumps(new))) - found.keys():
        new = {name: schemas[name] for name in names}
        found |= new
    return found


def test_no_body_of_a_patch_has_a_default_as_what_is_left_out_stays(api: "Api") -> None:
    """A program made of the document would send it: a new title would show a hidden phase."""
    document = api.app.openapi()
    changed = 0
    for path, method, operation in operations(document):
        if method == "patch":
            bodies = [operation["requestBody"], named_in(operation["requestBody"], document)]
            assert '"default":' not in json.dumps(bodies), path
            changed += 1
    assert changed >= 6
    made = named_in(document["paths"]["/api/v1/organizer/phases"]["post"]["requestBody"], document)
    assert made["NewPhase"]["properties"]["quota_per_day"]["default"] == 3
    assert made["NewPhasePolicy"]["properties"]["anonymous"]["default"] is False
    told = {(one.method, one.path): one for group in by_tag(document).values() for one in group}[
        "PATCH", "/api/v1/organizer/phases/{phase_id}"
    ]
    assert "Omitted fields stay" in " ".join(told.paragraphs)
    assert not [each for each in told.asks if ", else" in each.type_words]


def test_answers_may_gain_fields_and_bodies_take_none_that_is_unknown(api: "Api") -> None:
    document = api.app.openapi()
    answers = [each["responses"] for _, _, each in operations(document)]
    told = named_in([answers, document["webhooks"]], document)
    assert {"Board", "SubmissionView", "PhasePolicy", "Problem", "Confirmation"} <= set(told)
    assert not [
        name for name, schema in told.items() if schema.get("additionalProperties") is False
    ]
    assert "additionalProperties" in told["FamilyCell"]  # they say what further metrics are
    bodies = [each.get("requestBody") for _, _, each in operations(document)]
    sent = named_in(bodies, document)
    objects = {name: schema for name, schema in sent.items() if schema["type"] == "object"}
    assert {"PhaseChange", "PhasePolicyChange", "NewConfirmation"} <= set(objects)
    assert not [it for it in objects.values() if it["additionalProperties"] is not False]
    assert not [name for name in objects if name in told or objects[name]["title"] != name]


def test_the_headers_that_clients_go_by_stand_in_the_document(api: "Api") -> None:
    document = api.app.openapi()

    def headers(path: str, method: str, status: str) -> set[str]:
        response = document["paths"][path][method]["responses"][status]
        return set(response.get("headers", {}))

    assert "Location" in headers("/api/v1/submissions", "post", "202")
    assert "Location" in headers("/api/v1/contacts", "post", "201")
    assert headers("/api/v1/leaderboard", "get", "200") == {"ETag", "Link"}
    for path, method, operation in operations(document):
        for status in operation["responses"]:
            told = headers(path, method, status)
            if status in ("200", "304") and "304" in operation["responses"]:
                assert "ETag" in told, (method, path, status)
            if status in ("429", "503") and path != "/readyz":
                assert "Retry-After" in told, (method, path, status)
            if status == "401":
                assert "WWW-Authenticate" in told, (method, path)


def test_the_document_tells_what_webhooks_are_sent_by_the_names_that_are_sent(api: "Api") -> None:
    document = api.app.openapi()
    told = document["webhooks"]["notification"]["post"]
    assert {it["name"] for it in told["parameters"]} == {TIMESTAMP_HEADER, SIGNATURE_HEADER}
    assert "422" not in told["responses"]
    body = told["requestBody"]["content"]["application/json"]["schema"]
    assert body["$ref"].rpartition("/")[2] in document["components"]["schemas"]
    adding = document["paths"]["/api/v1/contacts"]["post"]["description"]
    assert TIMESTAMP_HEADER in adding
    assert SIGNATURE_HEADER in adding


def test_the_examples_of_the_documents_are_valid(api: "Api") -> None:
    document = api.app.openapi()
    shown = {
        name: schema["examples"]
        for name, schema in document["components"]["schemas"].items()
        if "examples" in schema and schema["type"] == "object"
    }
    assert {"Problem", "Board", "SubmissionView", "Manifest", "ScoreSheet"} <= set(shown)
    for name, examples in shown.items():
        whole = {"$ref": f"#/components/schemas/{name}", "components": document["components"]}
        for example in examples:
            Draft202012Validator(whole).validate(example)
    (problem,) = shown["Problem"]
    assert problem["title"] == PROBLEMS[ProblemCode(problem["code"])].title


def test_no_answer_on_a_hidden_split_has_a_field_for_what_is_withheld(api: "Api") -> None:
    schemas = api.app.openapi()["components"]["schemas"]
    split_only = {"Split", "SplitSample"}
    for name, schema in schemas.items():
        if name not in split_only and name != "Protocol" and "Section" not in name:
            fields = json.dumps(list(schema.get("properties", {})))
            assert name == "Task" or not HELD_BACK.search(fields), name


def wrong_bodies_are_refused(ctx: CheckContext, response: Any, case: "Case[Any]") -> bool | None:
    """Of an address alone it cannot be told what is wrong: an empty text is a word, too; a wrong body is refused."""
    parts = {} if case.meta is None else case.meta.components
    wrong = {part for part, info in parts.items() if info.mode.is_negative}
    if wrong != {ParameterLocation.BODY}:
        return None
    return negative_data_rejection(ctx, response, case)


REFUSED_BY_MEANING = {
    "PATCH /api/v1/organizer/phases/{phase_id}": "1.0 is a whole number to JSON Schema alone",
    "PATCH /api/v1/submissions/{submission_id}": "names hold no signs that cannot be shown",
    "PATCH /api/v1/organizer/site": "links are addresses, texts hold no signs that cannot be shown",
    "POST /api/v1/contacts": "an address fits its channel",
    "POST /api/v1/organizer/phases": "names hold no signs that cannot be shown",
    "PATCH /api/v1/organizer/teams/{team_id}": "names hold no signs that cannot be shown",
    "POST /api/v1/organizer/disqualifications/{disqualification_id}/reinstate": "a reason has words",
    "POST /api/v1/organizer/messages": "words hold no signs that cannot be shown",
    "POST /api/v1/organizer/submissions/{submission_id}/disqualify": "a reason has words",
    "POST /api/v1/organizer/team-imports": "the text is a table of teams",
    "POST /api/v1/organizer/teams/{team_id}/disqualify": "a reason has words",
    "POST /api/v1/organizer/teams/{team_id}/forget": "a reason has words",
    "POST /api/v1/organizer/people/{person_id}/forget": "a reason has words",
    "POST /api/v1/organizer/teams/{team_id}/merge": "a reason has words",
    "PATCH /api/v1/organizer/teams/{team_id}/allowances/{phase_id}": "it lies after the phase's deadline",
    "POST /api/v1/organizer/protocols": "the body is a protocol",
    "POST /api/v1/organizer/protocols/check": "the body is a protocol",
    "POST /api/v1/organizer/rescoring/verifications": "1.0 is a whole number to JSON Schema alone",
    "POST /api/v1/tokens/{token_id}/rotate": "1.0 is a whole number to JSON Schema alone",
    "POST /api/v1/tokens": "names hold no signs that cannot be shown",
    "POST /api/v1/organizer/teams/{team_id}/tokens": "names hold no signs that cannot be shown",
    "POST /api/v1/organizer/teams": "names hold no signs that cannot be shown",
    "POST /api/v1/submissions": "facts are JSON in a field of a form",
    "GET /api/v1/leaderboard": "each board has its own metrics to sort by",
    "GET /api/v1/leaderboard.csv": "each board has its own metrics to sort by",
    "GET /api/v1/leaderboard/facts": "a board is asked for by its number, date or protocol alone",
    "GET /api/v1/notifications": "a page begins after a message of the team",
    "GET /api/v1/submissions": "a page begins after a submission of the team",
}
"""What a schema allows and may be refused none the less, and why."""


def valid_requests_are_taken(ctx: CheckContext, response: Any, case: "Case[Any]") -> bool | None:
    """What the document allows is answered, or there is no such thing; never called malformed."""
    if case.operation.label in REFUSED_BY_MEANING and response.status_code == 400:
        problem = response.json()
        assert problem["code"] == "bad_request"
        assert problem["detail"]
        return None
    return positive_data_acceptance(ctx, response, case)


MODES = (GenerationMode.POSITIVE, GenerationMode.NEGATIVE)
load_all_checks()
REPLACED = {
    "negative_data_rejection": wrong_bodies_are_refused,
    "positive_data_acceptance": valid_requests_are_taken,
}
CHECKS: list[Any] = [REPLACED.get(check.__name__, check) for check in ALL_CHECKS.get_all()]


def test_every_check_of_schemathesis_is_made() -> None:
    assert len(CHECKS) >= 14
    assert {wrong_bodies_are_refused, valid_requests_are_taken} < set(CHECKS)


def test_what_may_be_refused_by_its_meaning_is_an_operation(api: "Api") -> None:
    labels = {
        f"{method.upper()} {path}"
        for path, method, operation in operations(api.app.openapi())
        if "requestBody" in operation
        or {"sort", "after"} & {it["name"] for it in operation.get("parameters", ())}
    }
    assert set(REFUSED_BY_MEANING) <= labels


def test_every_other_method_is_answered_with_all_that_the_address_takes(api: "Api") -> None:
    for path, methods in api.app.openapi()["paths"].items():
        takes = {method.upper() for method in methods}
        takes |= {"HEAD"} if "GET" in takes and not path.endswith("/events") else set()
        address = re.sub(r"{.+?}", "x", path)
        for method in {"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"} - takes:
            answer = api.client.request(method, address)
            assert answer.status_code == 405, (method, path)
            assert set(answer.headers["allow"].split(", ")) == takes, (method, path)


def filled(schema: dict[str, Any], document: dict[str, Any]) -> Any:
    """The smallest value that a schema takes, as far as its form goes."""
    schema = resolved(schema, document)
    if "default" in schema or "const" in schema or "enum" in schema:
        return schema.get("default", schema.get("const", schema.get("enum", [None])[0]))
    if schema.get("type") == "object":
        inner = schema.get("properties", {})
        return {name: filled(inner[name], document) for name in schema.get("required", ())}
    if schema.get("type") == "array":
        return [filled(schema["items"], document)] * schema.get("minItems", 0)
    of_kind = {"string": "abc", "integer": schema.get("minimum", 1), "number": 1, "boolean": True}
    return of_kind.get(schema.get("type", ""))


def resolved(schema: dict[str, Any], document: dict[str, Any]) -> dict[str, Any]:
    """A schema without references, and without the choice to leave its value out."""
    while "$ref" in schema or "anyOf" in schema:
        if "anyOf" in schema:
            schema = next(each for each in schema["anyOf"] if each.get("type") != "null")
        else:
            schema = document["components"]["schemas"][schema["$ref"].rpartition("/")[2]]
    return schema


def with_text(schema: dict[str, Any], document: dict[str, Any], text: str) -> Iterator[Any]:
    """Values of a schema, each with a text at one of the places where it takes one."""
    schema = resolved(schema, document)
    if schema.get("type") == "string":
        yield text
    elif schema.get("type") == "array":
        for inner in with_text(schema["items"], document, text):
            yield [inner]
    elif schema.get("type") == "object":
        rest = filled(schema, document)
        for name, of_name in schema.get("properties", {}).items():
            for inner in with_text(of_name, document, text):
                yield {**rest, name: inner}
        if isinstance(schema.get("additionalProperties"), dict):
            for inner in with_text(schema["additionalProperties"], document, text):
                yield {**rest, "abc": inner}


def test_half_of_a_surrogate_pair_is_refused_in_every_text_of_a_body(api: "Api") -> None:
    own = api.submit("a").json()["id"]
    document, tried = api.app.openapi(), 0
    known = {"team_id": "alpha", "phase_id": "dev", "submission_id": own}
    for path, method, operation in operations(document):
        content = operation.get("requestBody", {}).get("content", {})
        if "application/json" not in content:
            continue
        schema = content["application/json"]["schema"]
        address = re.sub("{(.+?)}", lambda found: known.get(found[1], "1"), path)
        for who, body in product(("alpha", "organizer"), with_text(schema, document, "\ud800")):
            answer = api.client.request(
                method,
                address,
                headers={**api.headers(who), "Content-Type": "application/json"},
                content=json.dumps(body),
            )
            assert answer.status_code in (400, 403, 404, 409), (method, path, body, answer.text)
            tried += 1
    assert tried > 200


def test_the_event_stream_is_what_the_document_says(api: "Api") -> None:
    """Each event is `submission`, its data a SubmissionView of the document."""
    document = api.app.openapi()
    operation = document["paths"]["/api/v1/submissions/{submission_id}/events"]["get"]
    content = operation["responses"]["200"]["content"]
    assert list(content) == ["text/event-stream"]
    own = api.submit("a").json()["id"]
    api.score(own)
    api.publish()
    answer = api.get(f"/submissions/{own}/events", "alpha")
    assert answer.headers["content-type"].startswith("text/event-stream")
    Draft202012Validator(content["text/event-stream"]["schema"]).validate(answer.text)
    data = [
        line.removeprefix("data: ") for line in answer.text.splitlines() if line.startswith("data")
    ]
    assert data
    whole = {"$ref": "#/components/schemas/SubmissionView", "components": document["components"]}
    for each in data:
        Draft202012Validator(whole).validate(json.loads(each))


@schemathesis.serializer("application/toml")
def as_toml(_: SerializationContext, value: Any) -> bytes:
    """Send what was generated as it is: text that is hardly ever a protocol."""
    return str(value).encode("utf-8", "replace")


@pytest.mark.row("I31")
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize(
    ("who", "examples"), [("an organizer", 6), ("a team", 4), ("a visitor", 4)]
)
def test_generated_requests_are_answered_as_the_document_says(
    make_api: Callable[..., "Api"],
    sqlite_url: str,
    make_entry: Callable[..., Any],
    who: str,
    examples: int,
) -> None:
    """Every operation, valid and invalid requests, as whoever may do everything, something, or nothing."""
    api = make_api(sqlite_url, events_longest_s=0.02)
    own = api.submit("a").json()["id"]
    api.score(own)
    api.publish(make_entry("Planner", submission_id=own))
    scopes = ORGANIZER_SCOPES if who == "an organizer" else TEAM_SCOPES
    with api.database.write() as session:
        team_id = api.team_ids["alpha"]
        token, _ = issue_token(session, team_id, who, scopes, actor="test")
    bearer = {} if who == "a visitor" else {"Authorization": f"Bearer {token}"}
    schema = schemathesis.openapi.from_asgi("/api/v1/openapi.json", api.app)
    tried = Counter[str]()
    for found in schema.get_all_operations():
        assert isinstance(found, Ok), found
        _try(found.ok(), bearer, examples, tried)
    assert len(tried) >= 30
    assert min(tried.values()) >= 1
    assert api.get("/phases/dev").status_code == 200


def _try(
    operation: "APIOperation[Any, Any, Any, Any]",
    headers: dict[str, str],
    examples: int,
    tried: Counter[str],
) -> None:
    """Send generated requests to one operation; a failure shows how to repeat it."""

    @settings(
        max_examples=examples,
        derandomize=True,
        database=None,
        deadline=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(case=strategies.one_of(*(operation.as_strategy(generation_mode=m) for m in MODES)))
    def send(case: "Case[Any]") -> None:
        tried[operation.label] += 1
        case.call_and_validate(headers=headers, checks=CHECKS)

    send()


def test_the_api_page_begins_with_what_a_program_needs_and_commands_that_fit(api: "Api") -> None:
    text = html.unescape(api.client.get("/api").text)
    text = " ".join(text.split())
    for words in (
        "Base address",
        "Authorization: Bearer",
        "Retry-After",
        "A file has at most",
        "Versions",
        "slow ones (408) may be answered in plain text",
        "Boards, entries and submissions are also JSON",
        "and with another method or other texts a 409",
        "pages of other sites cannot read responses in a browser",
    ):
        assert words in text, words
    commands = re.findall(r'<pre class="term"[^>]*>(.*?)</pre>', text, re.DOTALL)
    assert len(commands) == 3
    named = set(re.findall(r"http://[^/]+(/api/v1/[a-z.]+)", "".join(commands)))
    assert named == {"/api/v1/leaderboard", "/api/v1/leaderboard.csv", "/api/v1/submissions"}
    assert named <= set(api.app.openapi()["paths"])
    assert "phase=dev" in commands[0]
    told = api.get("/phases", headers={"Origin": "https://elsewhere.example"})
    assert told.status_code == 200
    assert not [name for name in told.headers if name.startswith("access-control")]
    upload = re.sub(r"<[^>]+>", "", commands[1])
    assert {"phase", "method", "file"} == set(re.findall(r"-F '?(\w+)=", upload))
