"""Small forms made from data: one line a field, used to render and to parse it.

A form that edits stored values also sends what each field showed at first (`was.NAME`): untouched
fields change nothing, and of two concurrent edits of a field the second is refused.
"""

import hashlib
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from starlette.datastructures import FormData

from exceptiondrive_records.db.errors import Conflict, InvalidRecord, RecordsError
from exceptiondrive_schemas.api.form_fields import FormField, Kind, document_of, values_of
from exceptiondrive_schemas.base import faults_in
from exceptiondrive_schemas.datetimes import in_utc

MAX_DIGITS = 9
NOTHING_KEPT: Mapping[str, str] = {}
_WAS = "was."
_SHORT = 80
Model = TypeVar("Model", bound=BaseModel)


@dataclass(frozen=True)
class Filled:
    """A field with what stands in it; `text` is what the browser shows."""

    field: FormField
    text: str
    was: str | None = None
    """Of a field of what is kept: stands for what is kept now."""

    @property
    def is_ticked(self) -> bool:
        """Whether a tick is set."""
        return self.text == "yes"

    @property
    def ticked(self) -> list[str]:
        """Which of several are ticked."""
        return self.text.split()


REASON = FormField(
    "reason",
    "Reason",
    "lines",
    "kept in the audit log, with your name",
    is_required=True,
    max_length=1000,
)


def filled_fields(
    fields: Sequence[FormField], texts: Mapping[str, str], kept: Mapping[str, str] = NOTHING_KEPT
) -> tuple[Filled, ...]:
    """Return the fields with these texts; a missing one is empty.

    `texts` may be all that was typed; of `kept`, what is kept of some fields now, a field that was
    left alone shows it.
    """
    return tuple(_filled(field, texts, kept) for field in fields)


def _filled(field: FormField, texts: Mapping[str, str], kept: Mapping[str, str]) -> Filled:
    text = texts.get(field.name, "")
    if field.name not in kept:
        return Filled(field, text)
    now = kept[field.name]
    if texts.get(_WAS + field.name) == _text_digest(_as_shown(field, text)):
        text = now
    return Filled(field, text, was=_text_digest(now))


def posted_texts(form: FormData) -> dict[str, str]:
    """Return what was typed, to be shown again; several ticks of one name are joined in one text."""
    return {
        name: " ".join(value for value in form.getlist(name) if isinstance(value, str))
        for name in form
    }


def read_form(
    fields: Sequence[FormField], form: FormData, kept: Mapping[str, str] = NOTHING_KEPT
) -> dict[str, Any]:
    """Return the values of the fields; an empty one that may be empty is None.

    Of a field that was left alone, what is kept of it now is returned, as `kept` shows it.

    Raises:
        InvalidRecord: Something is missing or wrong; every field that is so is named.
        Conflict: A field was changed here, and since the form was shown elsewhere.
    """
    values: dict[str, Any] = {}
    faults, changed_twice = [], []
    for field in fields:
        given = form.getlist(field.name) if field.kind == "several" else [form.get(field.name, "")]
        text = " ".join(map(str, given)).strip()
        try:
            values[field.name] = value = _value(field, text)
            was = form.get(_WAS + field.name)
            if was is None or field.name not in kept:
                continue
            mine, now = _text_digest(text_of(value)), _text_digest(kept[field.name])
            if mine == was:
                values[field.name] = _value(field, kept[field.name].strip())
            elif now not in (was, mine):
                changed_twice.append(f"{field.label}, which is {_in_short(field, kept)} now")
        except ValueError as error:
            faults.append(f"{field.label}: {error}.")
    if faults:
        raise InvalidRecord(" ".join(faults))
    if changed_twice:
        raise Conflict(
            f"Changed since this page was shown: {'; '.join(changed_twice)}. What you typed is "
            "still below; send it again to replace that."
        )
    return values


def changed_values(values: Mapping[str, Any], kept: Mapping[str, str]) -> dict[str, Any]:
    """Return the values that differ from what is kept; seconds are the finest that a form knows."""
    return {
        name: values[name]
        for name, text in kept.items()
        if _text_digest(text_of(values[name])) != _text_digest(text)
    }


def made_document(
    model: type[Model], fields: Sequence[FormField], values: Mapping[str, Any]
) -> Model:
    """Return a document made of the values of some of its fields.

    Raises:
        InvalidRecord: A value cannot be used.
    """
    try:
        return model.model_validate(document_of(fields, values))
    except ValidationError as error:
        raise InvalidRecord(" ".join(f"{fault}." for fault in faults_in(error))) from None


def by_label(refusal: RecordsError | None, fields: Sequence[FormField]) -> RecordsError | None:
    """Let a refusal call fields by their labels, which a form shows, and not as the API does."""
    if refusal is not None:
        labels = {field.name: f"“{field.label}”" for field in fields if "_" in field.name}
        words = re.sub(r"\w+_\w+", lambda name: labels.get(name[0], name[0]), str(refusal))
        refusal.args = (words,)
    return refusal


def text_of(value: object) -> str:
    """Return a value as its field shows it."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else ""
    if isinstance(value, tuple):
        return " ".join(map(str, value))
    if isinstance(value, float):
        return f"{value:.15g}"
    if isinstance(value, datetime):
        return value.astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%S")
    return str(value)


def texts_of(fields: Sequence[FormField], document: Any) -> dict[str, str]:
    """Return what the fields show of a document, or of what has its values."""
    return {name: text_of(value) for name, value in values_of(fields, document).items()}


def _as_shown(field: FormField, text: str) -> str:
    try:
        return text_of(_value(field, text.strip()))
    except ValueError:
        return text


def _in_short(field: FormField, kept: Mapping[str, str]) -> str:
    text = kept[field.name] or ("no" if field.kind == "yes" else "empty")
    return text if len(text) <= _SHORT else f"{text[:_SHORT]}…"


def _text_digest(text: str) -> str:
    """Return a digest of a text that ignores how a browser ends lines."""
    plain = text.replace("\r\n", "\n").strip()
    return hashlib.sha256(plain.encode()).hexdigest()[:16]


def _value(field: FormField, text: str) -> Any:
    if field.kind == "yes":
        return text == "yes"
    if field.kind == "several":
        return tuple(_parse_choice(field, one) for one in text.split())
    if not text:
        if field.is_required:
            raise ValueError("must not be empty")
        return "" if field.kind in ("text", "lines") else None
    text = text.replace("\r\n", "\n")  # browsers send two characters for the one that they count
    if len(text) > field.max_length:
        raise ValueError(f"is longer than {field.max_length} characters")
    return _READERS[field.kind](field, text)


def _whole_number(field: FormField, text: str) -> int:
    is_plain = text.isascii() and text.isdigit() and len(text) <= MAX_DIGITS
    if not (is_plain and field.lowest <= int(text) <= field.highest):
        raise ValueError(f"must be a whole number from {field.lowest} to {field.highest:,}")
    return int(text)


def _number(field: FormField, text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not field.lowest <= number <= field.highest:
        raise ValueError(f"must be a number from {field.lowest:g} to {field.highest:,g}")
    return number


def _parse_moment(field: FormField, text: str) -> datetime:
    try:
        return in_utc(datetime.fromisoformat(text))
    except ValueError:
        raise ValueError("must be a time in UTC such as 2026-11-21T12:00") from None


def _parse_choice(field: FormField, text: str) -> str:
    if text not in [value for value, _ in field.options]:
        raise ValueError("must be one of those offered")
    return text


_READERS: Mapping[Kind, Callable[[FormField, str], Any]] = {
    "text": lambda field, text: text,
    "lines": lambda field, text: text,
    "whole": _whole_number,
    "number": _number,
    "moment": _parse_moment,
    "choice": _parse_choice,
}


# What organizers send to the API: an unknown field is an error.


class Form(BaseModel):
    """Base of what is sent."""

    model_config = ConfigDict(extra="forbid")


class Action(Form):
    """An action of an organizer, and why."""

    reason: Annotated[str, Field(min_length=1, max_length=1000)]
