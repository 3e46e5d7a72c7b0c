"""A server newer than the client: every answer has keys that the client has never heard of.

The keys are put in by the OpenAPI document, at every depth, so that a new answer is covered as
soon as it is declared.
"""

import functools
import json
import pkgutil
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import httpx
import pytest
from hypothesis import find
from hypothesis.strategies import from_regex
from typer.testing import CliRunner

import exceptiondrive_schemas
from exceptiondrive import Client
from exceptiondrive.cli import app
from exceptiondrive.organizer import Organizer
from exceptiondrive_schemas.api.phase_report import PhaseReport
from exceptiondrive_schemas.base import Document, content_digest
from exceptiondrive_schemas.board import Board
from exceptiondrive_schemas.challenges import ChallengeId
from exceptiondrive_schemas.publish.examples import MODELS
from exceptiondrive_schemas.published import example_text
from exceptiondrive_server.app import create_app
from exceptiondrive_server.web.settings import ServerSettings

if TYPE_CHECKING:
    from tests.client.servers import CannedServer, Running

NEW = {"new_here": {"of_any_form": [1, "two"]}, "new_text": "text", "new_number": 0}


@functools.cache
def openapi() -> dict[str, Any]:
    """What the server says of itself; nothing is opened for that."""
    with TemporaryDirectory() as folder:
        settings = ServerSettings(database_url=f"sqlite:///{folder}/empty.db")
        return create_app(settings).openapi()


def answers() -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Path, method and schema of every JSON answer, refusals among them."""
    for path, methods in openapi()["paths"].items():
        for method, operation in methods.items():
            for status, answer in operation["responses"].items():
                for kind, content in answer.get("content", {}).items():
                    if "json" in kind and "schema" in content:
                        yield f"{method} {path} {status}", path, content["schema"]


def resolved(schema: dict[str, Any]) -> dict[str, Any]:
    """The schema that a reference names."""
    while "$ref" in schema:
        schema = openapi()["components"]["schemas"][schema["$ref"].rsplit("/", 1)[1]]
    return schema


def made(schema: dict[str, Any]) -> Any:
    """The smallest value with everything in it that a schema names."""
    schema = resolved(schema)
    for fixed in ("const", "default"):
        if schema.get(fixed) is not None:
            return schema[fixed]
    if "enum" in schema:
        return schema["enum"][0]
    if "anyOf" in schema:
        return made(schema["anyOf"][0])
    match schema.get("type"):
        case "object":
            of_maps = schema.get("additionalProperties")
            named = {key: made(part) for key, part in schema.get("properties", {}).items()}
            return named | ({"key": made(of_maps)} if isinstance(of_maps, dict) else {})
        case "array" if "prefixItems" in schema:
            return [made(part) for part in schema["prefixItems"]]
        case "array":
            return [made(schema["items"])] * schema.get("minItems", 1)
        case "string" if "pattern" in schema:
            return find(from_regex(schema["pattern"], fullmatch=True), lambda _: True)
        case "string" if schema.get("format") == "date-time":
            return "2026-11-22T12:00:00Z"
        case "string" if schema.get("format") == "date":
            return "2026-11-22"
        case "string":
            return "text"
        case "boolean":
            return True
        case "null":
            return None
        case kind:
            assert kind in ("integer", "number"), schema
            least = schema.get("minimum", schema.get("exclusiveMinimum", 0) + 1)
            return int(least) if kind == "integer" else least  # OpenAPI writes bounds as 1.0


def widened(value: Any, schema: dict[str, Any]) -> Any:
    """The value with new keys in every object; a map's keys are data and stay."""
    schema = resolved(schema)
    if "anyOf" in schema:
        fitting = (part for part in schema["anyOf"] if _fits(value, resolved(part)))
        return widened(value, next(fitting, {}))
    if isinstance(value, list):
        parts = schema.get("prefixItems") or [schema.get("items", {})] * len(value)
        return [widened(item, part) for item, part in zip(value, parts, strict=True)]
    if not isinstance(value, dict):
        return value
    fields, others = schema.get("properties"), schema.get("additionalProperties")
    of_others = others if isinstance(others, dict) else {}
    known = {key: widened(item, (fields or {}).get(key, of_others)) for key, item in value.items()}
    return known | NEW if fields else known


def without_new(value: Any) -> Any:
    """The value without the new keys that rows of metrics keep."""
    if isinstance(value, dict):
        return {key: without_new(item) for key, item in value.items() if key not in NEW}
    return type(value)(map(without_new, value)) if isinstance(value, list | tuple) else value


def _fits(value: Any, schema: dict[str, Any]) -> bool:
    kinds: dict[str, Any] = {"object": dict, "array": list, "null": type(None)}
    return isinstance(value, kinds.get(schema.get("type", ""), str | int | float))


def documents() -> dict[str, type[Document]]:
    """Every document of the schemas by its name."""
    for module in pkgutil.walk_packages(exceptiondrive_schemas.__path__, "exceptiondrive_schemas."):
        if not module.name.endswith("__main__"):
            import_module(module.name)
    waiting, found = [Document], {}
    while waiting:
        kind = waiting.pop()
        waiting.extend(kind.__subclasses__())
        found[kind.__name__] = kind
    return found


def documented() -> dict[str, dict[str, Any]]:
    """Every answer that is a document of the schemas, by the document's name."""
    known = documents()
    schemas = (schema for _, _, schema in answers())
    names = {
        part["$ref"].rsplit("/", 1)[1]: part
        for schema in schemas
        for part in (schema, schema.get("items", {}))
        if "$ref" in part
    }
    return {name: part for name, part in names.items() if name in known}


@functools.cache
def documented_answers() -> tuple[tuple[str, type[Document], dict[str, Any], Any], ...]:
    """Name, document, schema and a value of each."""
    examples = {
        model: model.model_validate_json(example_text(name)) for name, model in MODELS.items()
    }
    known = documents()
    return tuple(
        (name, known[name], schema, made(schema) if example is None else _said(example))
        for name, schema in documented().items()
        for example in [examples.get(known[name])]
    )


def _said(example: Document) -> Any:
    return json.loads(example.model_dump_json())


def test_every_documented_answer_is_read_with_new_keys_at_every_depth() -> None:
    found = documented_answers()
    assert {"Board", "SubmissionView", "Problem", "Receipt", "Me"} <= {each[0] for each in found}
    for name, kind, schema, value in found:
        today = kind.read(json.dumps(value))
        newer = kind.read(json.dumps(widened(value, schema)))
        assert without_new(newer.model_dump()) == today.model_dump(), name
        with pytest.raises(ValueError, match="Extra inputs are not permitted"):
            kind.model_validate_json(json.dumps(value | NEW))


def unheard_of(value: Any, schema: dict[str, Any]) -> Any:
    """The value with a word of tomorrow for each of several that are known, and each number out of bounds."""
    schema = resolved(schema)
    if "anyOf" in schema:
        fitting = (part for part in schema["anyOf"] if _fits(value, resolved(part)))
        return unheard_of(value, next(fitting, {}))
    if isinstance(value, list):
        parts = schema.get("prefixItems") or [schema.get("items", {})] * len(value)
        return [unheard_of(item, part) for item, part in zip(value, parts, strict=True)]
    if isinstance(value, dict):
        fields, others = schema.get("properties", {}), schema.get("additionalProperties")
        of_others = others if isinstance(others, dict) else {}
        return {key: unheard_of(item, fields.get(key, of_others)) for key, item in value.items()}
    if len(schema.get("enum", ())) > 1:
        return "of_tomorrow"
    return type(value)(schema["maximum"] + 1) if "maximum" in schema else value


def test_every_documented_answer_is_read_with_words_and_numbers_that_are_not_known_here() -> None:
    """But for those that scores follow from: there a word that is passed over would make another number."""
    changed = set()
    for name, kind, schema, value in documented_answers():
        newer = unheard_of(value, schema)
        if newer == value:
            continue
        changed.add(name)
        with pytest.raises(ValueError, match="Input should be"):
            kind.model_validate_json(json.dumps(newer))
        if kind.decides_scores:
            with pytest.raises(ValueError, match="Input should be"):
                kind.read(json.dumps(newer))
            continue
        today = _said(kind.read(json.dumps(value)))
        assert _said(kind.read(json.dumps(newer))) == unheard_of(today, schema), name
    assert {"NotificationView", "PhaseView", "SubmissionView", "Problem"} <= changed


@pytest.fixture
def newer(working: "Running", monkeypatch: pytest.MonkeyPatch) -> "Running":
    """A running server whose every JSON answer gains new keys on its way."""
    schemas = {key: schema for key, _, schema in answers()}
    send = httpx.Client.send

    def widen(client: httpx.Client, request: httpx.Request, **more: Any) -> httpx.Response:
        response = send(client, request, **more)
        if "json" not in response.headers.get("content-type", ""):
            return response
        schema = _schema_of(request, response, schemas)
        body = json.dumps(widened(json.loads(response.read()), schema)).encode()
        return httpx.Response(
            response.status_code,
            headers={"content-type": response.headers["content-type"]},
            content=body,
            request=request,
        )

    monkeypatch.setattr(httpx.Client, "send", widen)
    return working


def _schema_of(
    request: httpx.Request, response: httpx.Response, schemas: dict[str, dict[str, Any]]
) -> dict[str, Any]:
    steps = request.url.path.split("/")
    for key, schema in schemas.items():
        method, path, status = key.split()
        parts = path.split("/")
        same = len(parts) == len(steps) and all(
            part == step or part.startswith("{") for part, step in zip(parts, steps, strict=True)
        )
        if same and method == request.method.lower() and status == str(response.status_code):
            return schema
    raise AssertionError(f"undocumented: {request.method} {request.url} {response.status_code}")


def test_sdk_and_commands_work_with_a_newer_server(
    newer: "Running", planning_file: Callable[..., Path], split_file: Path, tmp_path: Path
) -> None:
    with Client(newer.url, newer.token) as client:
        submission = client.submit(planning_file(), phase="dev", method="Planner")
        assert submission.wait(60).rank == 1
        assert client.leaderboard(phase="dev").entries[0].metrics.keys() >= {"hcc", "ur"}
        assert client.me().team == "Alpha"
        assert client.submissions()
        assert [phase.id for phase in client.phases()] == ["dev", "words"]
        assert client.protocol("1.0").version == "1.0"
        assert client.split("tiny").name == "tiny"
    receipt, identifier = tmp_path / "receipt.json", submission.id
    for words in (
        ["leaderboard", "--phase", "dev"],
        ["status", identifier],
        ["submissions"],
        ["phases"],
        ["whoami"],
        ["manifest", "dev", "-o", str(tmp_path / "manifest.json")],
        ["receipt", "get", identifier, "-o", str(receipt)],
        ["withdraw", identifier, "--yes"],
    ):
        done = run(newer.url, newer.token, words)
        assert done.exit_code == 0, (words, done.stderr)
    missing = run(newer.url, newer.token, ["status", "no-such-submission"])
    assert "does not know" not in missing.stderr
    with Organizer(newer.url, newer.organizer_token) as organizer:
        assert organizer.teams()
    for words in (["teams", "list"], ["protocols", "list"], ["audit", "verify"]):
        done = run(newer.url, newer.organizer_token, ["organizer", *words])
        assert done.exit_code == 0, (words, done.stderr)


def test_of_a_challenge_that_came_later_programs_get_everything(
    canned_server: "CannedServer",
) -> None:
    """People are told to take a newer client: words and columns of the challenge are not known here."""
    board = Board.model_validate_json(example_text("board"))
    ended = PhaseReport(
        phase="dev",
        title="Development",
        challenge=ChallengeId("gaps"),
        opened_at=None,
        closed_at=board.published_at,
        board=1,
        board_digest=content_digest(board),
        published_at=board.published_at,
        split=board.split,
        part=None,
        protocol=board.protocol,
        n_samples=3,
        n_boards=1,
        n_teams=1,
        n_submissions=1,
        n_ranked=0,
        n_listed=1,
        winners=(),
        may_be_first=(),
        flags={},
        shake_up=None,
        protocols=("1.0",),
    )
    board = board.model_copy(update={"challenge": "gaps"})
    canned_server.answer("GET /leaderboard", 200, board.model_dump(mode="json", by_alias=True))
    canned_server.answer(f"GET /phases/{board.phase}", 200, phase_of(board))
    canned_server.answer("GET /phases/dev/report", 200, ended.model_dump(mode="json"))
    for words in (["leaderboard", "--phase", "dev"], ["report", "dev"]):
        told = run(canned_server.url, "t", words)
        assert (told.exit_code, "no challenge 'gaps' here" in told.stderr) == (5, True), told.stderr
        done = run(canned_server.url, "t", [*words, "--json"])
        assert json.loads(done.stdout)["challenge"] == "gaps", done.stderr
    of_planning = ended.model_copy(
        update={"challenge": ChallengeId("planning"), "n_samples": 1_000}
    )
    canned_server.answers["GET /phases/dev/report"].clear()
    canned_server.answer("GET /phases/dev/report", 200, of_planning.model_dump(mode="json"))
    done = run(canned_server.url, "t", ["report", "dev"])
    assert "1,000 samples; 1 team, 0 ranked, 1 without a rank" in done.stdout, done.stderr


@pytest.mark.parametrize(
    ("words", "route", "name"),
    [
        (["notices"], "GET /notifications", "NotificationView"),
        (["phases"], "GET /phases", "PhaseView"),
        (["status", "text"], "GET /submissions/text", "SubmissionView"),
    ],
)
def test_commands_show_what_has_words_that_are_not_known_here(
    canned_server: "CannedServer", words: list[str], route: str, name: str
) -> None:
    (newer,) = (unheard_of(each[3], each[2]) for each in documented_answers() if each[0] == name)
    canned_server.answer(route, 200, newer if words[0] == "status" else [newer])
    told = run(canned_server.url, "t", words)
    assert told.exit_code == 0, told.output
    done = run(canned_server.url, "t", [*words, "--json"])
    assert "of_tomorrow" in done.stdout, done.stderr


def phase_of(board: Board) -> dict[str, Any]:
    """Return the phase of a board, as the oldest server tells it."""
    return {
        "id": board.phase,
        "challenge": "gaps",
        "title": "Gaps",
        "split": board.split.name,
        "split_revision": board.split.revision,
        "split_is_public": True,
        "n_samples": board.n_samples,
        "protocol": board.protocol.version,
        "protocol_digest": board.protocol.digest,
        "is_open": True,
        "quota_per_day": 3,
        "max_upload_bytes": 1_000_000,
    }


def run(server: str, token: str, words: list[str]) -> Any:
    environment = {"EXCEPTIONDRIVE_SERVER": server, "EXCEPTIONDRIVE_TOKEN": token}
    return CliRunner().invoke(app, words, env=environment)
