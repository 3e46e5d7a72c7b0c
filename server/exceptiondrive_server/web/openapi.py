"""The OpenAPI document: every response of a route, with errors always as the one problem document."""

import json
import re
from collections.abc import Mapping
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi

from exceptiondrive_schemas.api.problems import PROBLEM_MEDIA_TYPE, Problem
from exceptiondrive_schemas.field_words import add_field_words, let_gain_fields
from exceptiondrive_schemas.published import example_text

TAGS = {
    "phases": "Dated stages of a challenge, and what a file for them must hold.",
    "splits": "Development splits; withheld splits are never here.",
    "submissions": "Upload, follow, withdraw. Another team's submission is not found.",
    "boards": "Ranked boards and their entries, each at a permanent address.",
    "receipts": "Signed proof of what was scored, to be checked offline.",
    "notifications": "What a team is told: protocol updates, what organizers do; scores, if an address subscribes to them.",
    "protocols": "How trajectories become scores.",
    "documents": "JSON Schema and an example of every file.",
    "access": "Who a token speaks for.",
    "organizers": "For organizers only.",
    "site": "Whether scoring keeps up, and the links of the site.",
    "health": "For operators; outside the versioned API.",
}
_SCHEMA = "#/components/schemas/"
_REFERENCE = re.compile(f'"{_SCHEMA}([^"]+)"')
_EXAMPLES = {"Problem": "problem", "Board": "board", "SubmissionView": "submission"}
_EXAMPLES |= {"Manifest": "manifest", "Protocol": "protocol", "ScoreSheet": "score-sheet"}
_UNUSED = ("HTTPValidationError", "ValidationError")


def describe(app: FastAPI) -> dict[str, Any]:
    """Return the document, made once."""
    if app.openapi_schema is None:
        document = get_openapi(
            title=app.title,
            version=app.version,
            description=app.description,
            routes=app.routes,
            webhooks=app.webhooks.routes,
            tags=[{"name": name, "description": text} for name, text in TAGS.items()],
        )
        _add_problem(document)
        add_field_words(document["components"]["schemas"])
        for operations in document["paths"].values():
            for operation in operations.values():
                _complete(operation["responses"])
        _part_bodies_from_answers(document)
        app.openapi_schema = document
    return app.openapi_schema


def _add_problem(document: dict[str, Any]) -> None:
    """Add the problem document, and the published example of each file to its schema."""
    schemas = document["components"]["schemas"]
    problem = Problem.model_json_schema(ref_template=_SCHEMA + "{model}", mode="serialization")
    schemas.update(problem.pop("$defs", {}))
    schemas["Problem"] = problem
    for name in _UNUSED:
        schemas.pop(name, None)
    for name, example in _EXAMPLES.items():
        if name in schemas:
            schemas[name]["examples"] = [json.loads(example_text(example))]


_WAIT = {
    "Retry-After": {
        "description": "Seconds to wait; left out where waiting does not help.",
        "schema": {"type": "integer", "minimum": 1},
    }
}
_OF_PROBLEM: Mapping[str, dict[str, Any]] = {
    "401": {"WWW-Authenticate": {"description": "`Bearer`", "schema": {"type": "string"}}},
    "429": _WAIT,
    "503": _WAIT,
}
_OF_UNCHANGED = {
    "ETag": {
        "description": "To send in `If-None-Match`: a 304 without a body says that nothing changed.",
        "schema": {"type": "string"},
    }
}


def _complete(responses: dict[str, Any]) -> None:
    """Say that any other error is a problem too, and which headers come; FastAPI's 422 is never given."""
    responses.pop("422", None)
    for status, response in responses.items():
        headers = _OF_UNCHANGED if status in ("200", "304") and "304" in responses else {}
        if PROBLEM_MEDIA_TYPE in response.get("content", {}):
            headers = _OF_PROBLEM.get(status, {})
        if headers:
            response["headers"] = {**response.get("headers", {}), **headers}
    content = {PROBLEM_MEDIA_TYPE: {"schema": {"$ref": _SCHEMA + "Problem"}}}
    responses["default"] = {"description": "Any other error, as a problem.", "content": content}


def _part_bodies_from_answers(document: dict[str, Any]) -> None:
    """Let answers gain fields, and take the defaults from bodies of a PATCH: what these leave out stays.

    What bodies and answers share gets a schema of its own for bodies, which take no unknown field.
    """
    schemas = document["components"]["schemas"]
    operations = [each for methods in document["paths"].values() for each in methods.items()]
    answers = [each["responses"] for _, each in operations]
    told = _schema_names(schemas, [answers, document["webhooks"]])
    for method, operation in operations:
        if "requestBody" in operation:
            _describe_body(operation, schemas, told, is_change=method == "patch")
    for name in told:
        let_gain_fields(schemas[name])


def _describe_body(
    operation: dict[str, Any], schemas: dict[str, Any], told: set[str], *, is_change: bool
) -> None:
    sent = _schema_names(schemas, operation["requestBody"])
    shared = [name for name in sent & told if "properties" in schemas[name]]
    names = {name: f"{name}Change" if is_change else f"New{name}" for name in shared}
    operation["requestBody"] = _with_renamed_schemas(operation["requestBody"], names)
    for name in sorted(sent):
        own = names.get(name, name)
        schemas[own] = {**_with_renamed_schemas(schemas[name], names), "title": own}
        if is_change:
            for field in schemas[own].get("properties", {}).values():
                field.pop("default", None)


def _schema_names(schemas: dict[str, Any], node: Any) -> set[str]:
    """Return the names of the schemas that a part of the document is made of."""
    names: set[str] = set()
    new = set(_REFERENCE.findall(json.dumps(node)))
    while new:
        names |= new
        new = set(_REFERENCE.findall(json.dumps([schemas[name] for name in new]))) - names
    return names


def _with_renamed_schemas(node: dict[str, Any], names: Mapping[str, str]) -> dict[str, Any]:
    """Return a copy that refers to other schemas where they have another name."""
    text = _REFERENCE.sub(
        lambda found: f'"{_SCHEMA}{names.get(found[1], found[1])}"', json.dumps(node)
    )
    return json.loads(text)  # type: ignore[no-any-return]
