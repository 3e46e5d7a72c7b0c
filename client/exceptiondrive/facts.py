"""Facts of a method as people give them: a document, a mapping, a JSON file, or `key=value`."""

import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from exceptiondrive.errors import InvalidArgumentError, reason_of
from exceptiondrive_schemas.api.form_fields import FormField, fields_of
from exceptiondrive_schemas.method_facts import MethodFacts

Facts = MethodFacts | Mapping[str, Any] | str | os.PathLike[str]
_FIELDS = {field.name: field for field in fields_of(MethodFacts)}


def facts_of(given: Facts) -> MethodFacts:
    """Return facts from a document, a mapping, or the path of a JSON file.

    What is not named stays unset, so that an edit leaves it as it is.

    Raises:
        InvalidArgumentError: The file cannot be read, or a fact cannot be used.
    """
    if isinstance(given, MethodFacts):
        return given
    if isinstance(given, Mapping):
        return _validated_facts(given)
    try:
        return _validated_facts(json.loads(Path(given).read_text(encoding="utf-8")))
    except (OSError, TypeError, ValueError, RecursionError) as error:
        raise InvalidArgumentError(
            "wrong_facts", f"{given}: this is no JSON file of facts ({reason_of(error)})."
        ) from None


def facts_of_pairs(
    pairs: Iterable[str], file: str | os.PathLike[str] | None = None
) -> MethodFacts | None:
    """Return facts from `key=value` and a file; the pairs win. None where nothing is given.

    Several sensors are separated by commas; an empty value takes a fact away.

    Raises:
        InvalidArgumentError: A fact is unknown or cannot be used.
    """
    told: dict[str, Any] = {}
    if file is not None:
        told |= facts_of(file).model_dump(exclude_unset=True)
    for pair in pairs:
        name, has_value, text = pair.partition("=")
        field = _FIELDS.get(name.strip().replace("-", "_"))
        if field is None or not has_value:
            raise InvalidArgumentError(
                "wrong_facts",
                f"{pair!r} is no fact. Write key=value; the keys are {', '.join(_FIELDS)}.",
            )
        told[field.name] = _parse_value(field, text.strip())
    return _validated_facts(told) if told else None


def _parse_value(field: FormField, text: str) -> Any:
    if field.kind == "several":
        return tuple(one.strip() for one in text.split(",") if one.strip())
    if field.kind == "number" and text:
        try:
            return float(text)
        except ValueError:
            raise InvalidArgumentError(
                "wrong_facts", f"{field.name} is a number, not {text!r}."
            ) from None
    return None if field.may_be_none and not text else text


def _validated_facts(told: Any) -> MethodFacts:
    try:
        return MethodFacts.model_validate(told)
    except ValidationError as error:
        words = [_fault_words(fault["loc"], fault["msg"]) for fault in error.errors()]
        raise InvalidArgumentError("wrong_facts", " ".join(dict.fromkeys(words))) from None


def _fault_words(place: tuple[int | str, ...], message: str) -> str:
    field = _FIELDS.get(str(place[0])) if place else None
    if field is None:
        name = ".".join(map(str, place)) or "the document"
        return f"{name} is no fact; the keys are {', '.join(_FIELDS)}."
    if field.options:
        return f"{field.name} is {', '.join(value for value, _ in field.options)}."
    return f"{field.name}: {message}."
