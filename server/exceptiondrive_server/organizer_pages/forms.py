"""Small forms made from data: each field is one line, for the page and for reading it back."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Literal

from starlette.datastructures import FormData

from exceptiondrive_records.errors import InvalidRecord
from exceptiondrive_schemas.datetimes import in_utc

Kind = Literal["text", "lines", "whole", "moment", "yes", "choice"]
"""A line, several lines, a whole number, a time in UTC, a tick, or one of a list."""
MAX_DIGITS = 9
Option = tuple[str, str]
"""Value and title of a choice."""


@dataclass(frozen=True)
class Field:
    """One field of a form."""

    name: str
    label: str
    kind: Kind = "text"
    hint: str = ""
    is_required: bool = False
    max_length: int = 200
    lowest: int = 1
    highest: int = 1_000_000
    options: tuple[Option, ...] = ()
    empty: str = "none"
    """What a choice says that may stay empty."""


@dataclass(frozen=True)
class Filled:
    """A field with what stands in it; `text` is what the browser shows."""

    field: Field
    text: str

    @property
    def is_ticked(self) -> bool:
        """Whether a tick is set."""
        return self.text == "yes"


REASON = Field(
    "reason",
    "Reason",
    "lines",
    "stands in the audit log, with your name",
    is_required=True,
    max_length=1000,
)


def filled(fields: Sequence[Field], texts: Mapping[str, str]) -> tuple[Filled, ...]:
    """Return the fields with these texts; a missing one is empty."""
    return tuple(Filled(field, texts.get(field.name, "")) for field in fields)


def typed(form: FormData) -> dict[str, str]:
    """Return what was typed, to be shown again."""
    return {name: value for name, value in form.items() if isinstance(value, str)}


def read(fields: Sequence[Field], form: FormData) -> dict[str, Any]:
    """Return the values of the fields; an empty one that may be empty is None.

    Raises:
        InvalidRecord: Something is missing or wrong; every field that is so is named.
    """
    values: dict[str, Any] = {}
    faults = []
    for field in fields:
        text = str(form.get(field.name, "")).strip()
        try:
            values[field.name] = _value(field, text)
        except ValueError as error:
            faults.append(f"{field.label}: {error}.")
    if faults:
        raise InvalidRecord(" ".join(faults))
    return values


def text_of(value: object) -> str:
    """Return a value as its field shows it."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else ""
    if isinstance(value, datetime):
        return value.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%S")
    return str(value)


def _value(field: Field, text: str) -> Any:
    if field.kind == "yes":
        return text == "yes"
    if not text:
        if field.is_required:
            raise ValueError("must not be empty")
        return "" if field.kind in ("text", "lines") else None
    if len(text) > field.max_length:
        raise ValueError(f"is longer than {field.max_length} characters")
    return _READERS[field.kind](field, text)


def _whole(field: Field, text: str) -> int:
    is_plain = text.isascii() and text.isdigit() and len(text) <= MAX_DIGITS
    if not (is_plain and field.lowest <= int(text) <= field.highest):
        raise ValueError(f"must be a whole number from {field.lowest} to {field.highest:,}")
    return int(text)


def _moment(field: Field, text: str) -> datetime:
    try:
        return in_utc(datetime.fromisoformat(text))
    except ValueError:
        raise ValueError("must be a time in UTC such as 2026-11-21T12:00") from None


def _choice(field: Field, text: str) -> str:
    if text not in [value for value, _ in field.options]:
        raise ValueError("must be one of those offered")
    return text


_READERS: Mapping[Kind, Callable[[Field, str], Any]] = {
    "text": lambda field, text: text,
    "lines": lambda field, text: text.replace("\r\n", "\n"),
    "whole": _whole,
    "moment": _moment,
    "choice": _choice,
}
