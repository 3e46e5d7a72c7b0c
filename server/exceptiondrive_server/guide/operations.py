"""The operations on the API page, made from the application's own OpenAPI document."""

import json
from collections import defaultdict
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

METHODS = ("get", "post", "put", "patch", "delete")
Node = Mapping[str, Any]
"""A part of the description."""


class Field(NamedTuple):
    """What a request says, or an answer: `where` is path, query, header, body or answer."""

    name: str
    where: str
    type_words: str
    is_required: bool
    words: str


class Operation(NamedTuple):
    """One method of one path; `schema` names what it answers, `sample` is such an answer as JSON."""

    method: str
    path: str
    paragraphs: tuple[str, ...]
    takes_token: bool
    needs_token: bool
    asks: tuple[Field, ...]
    status: str
    schema: str
    answers: tuple[Field, ...]
    problems: tuple[str, ...]
    """Codes of the problems that it may answer, besides those of any request."""
    sample: str

    @property
    def anchor(self) -> str:
        """Where it stands on the page."""
        return f"{self.method.lower()}{self.path.replace('/', '-')}".replace("{", "").replace(
            "}", ""
        )


def operations(description: Node) -> dict[str, list[Operation]]:
    """Return every operation by tag, in the order of an OpenAPI description."""
    groups = defaultdict(list)
    schemas = description.get("components", {}).get("schemas", {})
    for path, item in description.get("paths", {}).items():
        for method in METHODS:
            if method in item:
                tag = (item[method].get("tags") or ["other"])[0]
                groups[tag].append(_operation(method.upper(), path, item[method], schemas))
    return dict(groups)


def _operation(method: str, path: str, told: Node, schemas: Node) -> Operation:
    responses = told.get("responses", {})
    taken = [code for code in sorted(responses) if code < "300"]
    name, answer = _resolved_schema(_content(responses.get(taken[0], {}) if taken else {}), schemas)
    body = _resolved_schema(_content(told.get("requestBody", {})), schemas)[1]
    codes = [_problem_codes(each) for code, each in responses.items() if "400" <= code < "500"]
    return Operation(
        method=method,
        path=path,
        paragraphs=tuple(
            [" ".join(part.split()) for part in told.get("description", "").split("\n\n")]
        ),
        takes_token="security" in told,
        needs_token={} not in told.get("security", [{}]),
        asks=(*map(_parameter, told.get("parameters", ())), *_fields(body, "body")),
        status=" or ".join(taken),
        schema=name,
        answers=tuple(_fields(answer, "answer")),
        problems=tuple([code for each in codes for code in each]),
        sample="".join(
            [
                json.dumps(_shortened_example(example), indent=2)
                for example in answer.get("examples", ())[:1]
            ]
        ),
    )


def _content(message: Node) -> Node:
    """The schema of what a message carries; nothing where it carries nothing."""
    kinds = message.get("content", {})
    return next((kind.get("schema", {}) for kind in kinds.values()), {})


def _resolved_schema(schema: Node, schemas: Node) -> tuple[str, Node]:
    """The name of a schema, `list of NAME` of a list, and what it says."""
    if schema.get("type") == "array":
        name, inner = _resolved_schema(schema.get("items", {}), schemas)
        return f"list of {name}", {key: inner[key] for key in inner if key != "examples"}
    name = schema.get("$ref", "").rpartition("/")[2]
    return name, schemas.get(name, schema)


def _fields(schema: Node, where: str) -> Iterator[Field]:
    required = schema.get("required", ())
    for name, node in schema.get("properties", {}).items():
        words = node.get("description", "")
        yield Field(name, where, type_words(node), name in required, " ".join(words.split()))


def _parameter(told: Node) -> Field:
    words = " ".join(told.get("description", "").split())
    kind = type_words(told["schema"])
    return Field(told["name"], told["in"], kind, told.get("required", False), words)


def type_words(node: Node) -> str:
    """Say in a few words what a value may be."""
    several = node.get("anyOf") or node.get("oneOf")
    if several:
        return " or ".join(dict.fromkeys([type_words(each) for each in several]))
    if "$ref" in node:
        return str(node["$ref"]).rpartition("/")[2]
    if "enum" in node:
        return " or ".join(str(value) for value in node["enum"])
    if "const" in node:
        return str(node["const"])
    if node.get("type") == "array":
        return f"list of {type_words(node.get('items', {}))}"
    ends = [("minimum", "at least"), ("maximum", "at most"), ("default", "else")]
    told = [
        f"{words} {_plain_number(node[key])}"
        for key, words in ends
        if node.get(key) not in (None, "")
    ]
    return ", ".join([str(node.get("format") or node.get("type") or "any value"), *told])


def _plain_number(value: Any) -> Any:
    """A whole number without its `.0`."""
    return int(value) if isinstance(value, float) and value.is_integer() else value


def _problem_codes(answer: Node) -> list[str]:
    """The codes that stand in backticks in what is said of an answer."""
    return answer.get("description", "").split("`")[1::2]  # type: ignore[no-any-return]


def _shortened_example(example: Any) -> Any:
    """The first of each list: one row shows what all look like."""
    if isinstance(example, dict):
        return {key: _shortened_example(value) for key, value in example.items()}
    return (
        [_shortened_example(value) for value in example[:1]]
        if isinstance(example, list)
        else example
    )
