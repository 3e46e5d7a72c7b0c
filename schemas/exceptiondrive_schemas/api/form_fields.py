"""The fields of a form or command line, derived from a model, so that each is declared once."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal

from pydantic import BaseModel

Kind = Literal["text", "lines", "whole", "number", "moment", "yes", "choice", "several"]
"""One line, several lines, integer, number, time in UTC, yes or no, one or several of a list."""
LINES_FROM = 1000
"""Text that may be longer than this many characters gets a multi-line field."""


@dataclass(frozen=True)
class FormField:
    """One field: its name, and the values that it takes."""

    name: str
    label: str
    kind: Kind = "text"
    hint: str = ""
    is_required: bool = False
    """Whether it must not be empty."""
    max_length: int = 200
    lowest: float = 1
    highest: float = 1_000_000
    options: tuple[tuple[str, str], ...] = ()
    """Value and title of each choice."""
    empty: str = "none"
    """The text of the empty choice, if it may be empty."""
    default: Any = None
    may_be_none: bool = False
    part: str | None = None
    """The nested document that the field belongs to."""


@cache
def fields_of(model: type[BaseModel]) -> tuple[FormField, ...]:
    """Return a field for each field of a model and of its nested documents, in order."""
    schema = model.model_json_schema()
    return tuple(_fields(schema, schema.get("$defs", {}), None))


def document_of(fields: Sequence[FormField], values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the document of a model from values of some of its fields."""
    document: dict[str, Any] = {}
    for field in fields:
        if field.name in values:
            target = document if field.part is None else document.setdefault(field.part, {})
            target[field.name] = values[field.name]
    return document


def values_of(fields: Sequence[FormField], document: object) -> dict[str, Any]:
    """Return the value of each field, read from an object with attributes of the same names."""
    return {
        field.name: getattr(
            document if field.part is None else getattr(document, field.part), field.name
        )
        for field in fields
    }


def _fields(
    schema: Mapping[str, Any], definitions: Mapping[str, Any], part: str | None
) -> Iterator[FormField]:
    for name, given in schema["properties"].items():
        inner = definitions.get(given.get("$ref", "").removeprefix("#/$defs/"), {})
        if "properties" in inner:
            yield from _fields(inner, definitions, name)
        else:
            yield _field(name, {**inner, **given}, part, name in schema.get("required", ()))


def _field(name: str, given: Mapping[str, Any], part: str | None, is_needed: bool) -> FormField:
    choices = [one for one in given.get("anyOf", ()) if one.get("type") != "null"]
    may_be_none = "anyOf" in given
    rule = {**given, **choices[0]} if choices else given
    kind = _kind(rule)
    return FormField(
        name=name,
        label=given.get("title", name),
        kind=kind,
        hint=given.get("description", ""),
        is_required=is_needed or (kind in ("choice", "whole") and not may_be_none),
        max_length=rule.get("maxLength", FormField.max_length),
        lowest=rule.get("minimum", FormField.lowest),
        highest=rule.get("maximum", FormField.highest),
        options=tuple(_options(rule)),
        default=given.get("default"),
        may_be_none=may_be_none,
        part=part,
    )


def _options(rule: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    titles = rule.get("x-titles", {})
    for value in rule.get("enum", rule.get("items", {}).get("enum", ())):
        yield value, titles.get(value, value.replace("_", " "))


def _kind(rule: Mapping[str, Any]) -> Kind:
    if "enum" in rule:
        return "choice"
    if rule["type"] == "string":
        if rule.get("format") == "date-time":
            return "moment"
        return "lines" if rule.get("maxLength", 0) > LINES_FROM else "text"
    kinds: Mapping[str, Kind] = {
        "integer": "whole",
        "number": "number",
        "boolean": "yes",
        "array": "several",
    }
    return kinds[rule["type"]]
