"""Faults of a protocol document, one line each, for the organizer who wrote it.

A line names the place (with the id of the task or family, not its index alone), the expected value
and the actual one.
"""

import json
import math
from collections.abc import Iterator, Mapping
from datetime import date, time
from difflib import get_close_matches
from typing import Any

from pydantic import BaseModel, ValidationError

Place = tuple[str | int, ...]
MOST_LINES = 100
_LONGEST = 60
_OWN_WORDS = "Value error, "
_KEY = "letters, digits and underscores, with a letter in front"
_SHAPES: Mapping[str | int, str] = {
    "version": "a version such as 1.1 or 1.2-draft",
    "id": _KEY,
    "name": _KEY,
    "family": _KEY,
}
"""Descriptions of the patterns of names."""


def unkeepable(document: Mapping[str, Any]) -> Iterator[str]:
    """Name every value that TOML allows and a protocol does not: times and non-finite numbers."""
    for place, value in _leaves(document, ()):
        if isinstance(value, date | time):
            yield f"{_place_text(place, document)}: should be a number or text, not a date or time"
        elif isinstance(value, float) and not math.isfinite(value):
            yield f"{_place_text(place, document)}: should be a finite number, not {value}"


def _leaves(value: object, place: Place) -> Iterator[tuple[Place, object]]:
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from _leaves(inner, (*place, name))
    elif isinstance(value, list):
        for number, inner in enumerate(value):
            yield from _leaves(inner, (*place, number))
    else:
        yield place, value


def faults_of(
    error: ValidationError, document: Mapping[str, Any], models: Mapping[str, type[BaseModel]]
) -> list[str]:
    """Return a line for each violation of the schema.

    The models give the allowed names of each section; `""` is the document itself.
    """
    found = error.errors(include_url=False)
    lines = [_line(item, document, models) for item in found[:MOST_LINES]]
    left_out = len(found) - len(lines)
    return [*lines, f"and {left_out} more"] if left_out else lines


def _line(item: Any, document: Mapping[str, Any], models: Mapping[str, type[BaseModel]]) -> str:
    place: Place = item["loc"]
    where = _place_text(place, document) or "document"
    kind, message = item["type"], str(item["msg"])
    if kind == "missing":
        return f"{where}: is missing"
    if kind == "extra_forbidden":
        return f"{where}: is not in a protocol{_suggestion(place, models)}"
    if message.startswith(_OWN_WORDS):
        return f"{where}: {message.removeprefix(_OWN_WORDS)}"
    shape = _SHAPES.get(place[-1] if place else "") if kind == "string_pattern_mismatch" else None
    if shape is not None:
        return f"{where}: should be {shape}{_given_value(item['input'])}"
    thing, should, rest = message.partition(" should ")
    if should and " " not in thing:  # "Input should", "String should"
        return f"{where}: should {rest}{_given_value(item['input'])}"
    return f"{where}: {message}"


def _suggestion(place: Place, models: Mapping[str, type[BaseModel]]) -> str:
    """Name what was probably meant: a unit or a letter is easily mistyped."""
    section = str(place[0]) if len(place) > 1 else ""
    model = models.get(section)
    if model is None:
        return ""
    known = [field.alias or name for name, field in model.model_fields.items()]
    near = get_close_matches(str(place[-1])[:_LONGEST], known, n=1, cutoff=0.7)
    return f"; is {near[0]} meant?" if near else ""


def _given_value(value: object) -> str:
    if isinstance(value, str | int | float | bool):
        text = json.dumps(value)
        return f", not {text if len(text) <= _LONGEST else text[:_LONGEST] + '...'}"
    return ""


def _place_text(place: Place, document: Any) -> str:
    """Write a place as `tasks.3 (LB1).d_safe_m`."""
    parts = []
    for step in place:
        document = _item_at(document, step)
        name = str(step)[:_LONGEST]
        key = document.get("id") if isinstance(document, dict) else None
        parts.append(f"{name} ({key[:_LONGEST]})" if isinstance(key, str) else name)
    return ".".join(parts)


def _item_at(document: Any, step: str | int) -> Any:
    try:
        return document[step]
    except (LookupError, TypeError):
        return None
