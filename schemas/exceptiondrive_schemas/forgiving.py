"""Lenient reading of a newer server's answers: unknown words and numbers are kept as they are.

Strict reading comes first and suffices for most answers. If it finds only such values, they are
replaced by known ones for validation, and then restored.
"""

import json
import re
from collections.abc import Callable
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from exceptiondrive_schemas.python310 import StrEnum

FORGIVING = "reader of answers"
"""Validation context of `Document.read`."""
_Read = TypeVar("_Read")


def read_newer(read: Callable[[str | bytes], _Read], answer: str | bytes) -> _Read:
    """Return `read` of an answer, with unknown words and numbers out of bounds kept as they are.

    Raises:
        ValidationError: Something else is wrong.
    """
    try:
        return read(answer)
    except ValidationError as error:
        # a list with invalid items is also reported as too short
        faults = [each for each in error.errors() if each["type"] != "too_short"]
        try:
            known = [_known_instead(fault) for fault in faults]
            said = json.loads(answer)
            for fault, instead in zip(faults, known, strict=True):
                said = _with_value_at(said, fault["loc"], instead)
        except (LookupError, TypeError):
            raise error from None
    found = read(json.dumps(said))
    for fault in faults:
        found = _with_value_at(found, fault["loc"], fault["input"])
    return found


def _known_instead(fault: ErrorDetails) -> Any:
    """Return a known value for an unknown one. A `Literal` of one word is the form of a document.

    Raises:
        LookupError: It is wrong in another way.
    """
    bounds = fault.get("ctx", {})
    if fault["type"] in ("literal_error", "enum") and isinstance(fault["input"], str):
        return re.findall("'([^']+)'", bounds["expected"])[:-1][0]
    return bounds["le" if fault["type"] == "less_than_equal" else "ge"]


def _with_value_at(into: Any, place: tuple[int | str, ...], value: Any) -> Any:
    """Return lists, objects or documents with a value at a place."""
    if not place:
        return _new_member(type(into), value) if isinstance(into, StrEnum) else value
    key, *rest = place
    if isinstance(into, tuple):
        return tuple(_with_value_at(list(into), place, value))
    inside: Any = into.__dict__ if isinstance(into, BaseModel) else into  # not shared yet
    inside[key] = _with_value_at(inside[key], tuple(rest), value)
    return into


def _new_member(kind: type[StrEnum], word: str) -> StrEnum:
    """Return a member for a word of a newer server; it is not added to the enumeration."""
    member = str.__new__(kind, word)
    member._name_ = member._value_ = word
    return member
