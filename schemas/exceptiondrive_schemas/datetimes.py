"""Dates and times from users: ISO 8601 text, converted to UTC."""

import re
from datetime import date, datetime
from typing import Annotated

from pydantic import AfterValidator, AwareDatetime, BeforeValidator, Field

from exceptiondrive_schemas.base import in_words
from exceptiondrive_schemas.python310 import UTC

_DATE = re.compile(r"\d{4}-\d{2}-\d{2}")
_BLANK_ZONE = re.compile(r"(T[0-9:.]+) ([0-9]{2}:?[0-9]{2})$")
_SENTENCE = "must be {} such as 2026-11-21T12:00:00Z"
_DATE_OR_TIME = _SENTENCE.format("a date such as 2026-11-21 or a time")


def in_utc(time: datetime) -> datetime:
    """Return the time in UTC; one without a zone is taken as UTC.

    Raises:
        ValueError: It is out of the calendar's range.
    """
    try:
        return time.astimezone(UTC) if time.tzinfo else time.replace(tzinfo=UTC)
    except OverflowError:
        raise ValueError("must lie within the years 1 to 9999") from None


def with_zone_sign(text: str) -> str:
    """Return a time from a URL with the plus of its zone restored, if it was not sent as %2B."""
    return _BLANK_ZONE.sub(r"\1+\2", text)


def _text_or_time(value: object) -> object:
    """Reject what pydantic would also read as a time: a number of seconds or milliseconds."""
    if isinstance(value, str) and _DATE.match(value) is None:
        raise ValueError(_SENTENCE.format("text"))
    if value is None or isinstance(value, str | datetime):
        return value
    raise ValueError(_SENTENCE.format("text"))


def _date_or_time(value: object) -> object:
    """Keep a bare date as a date: pydantic would turn it into its midnight."""
    if not isinstance(value, str):
        return value
    if _DATE.match(value) is None:
        raise ValueError(_DATE_OR_TIME)
    try:
        return date.fromisoformat(value)
    except ValueError:
        if len(value) == len("2026-11-21"):
            raise ValueError("must be a day of the calendar") from None
        return with_zone_sign(value)


def _moment_in_utc(value: datetime | date) -> datetime | date:
    return in_utc(value) if isinstance(value, datetime) else value


Time = Annotated[
    AwareDatetime,
    Field(strict=False),
    in_words(_SENTENCE.format("a time with its zone,")),
    BeforeValidator(_text_or_time),
    AfterValidator(in_utc),
]
"""A time with its zone, stored in UTC; a text in every form of JSON."""
Moment = Annotated[
    datetime | date,
    in_words(_DATE_OR_TIME),
    BeforeValidator(_date_or_time),
    AfterValidator(_moment_in_utc),
]
"""A time, or a whole day."""


def first_moment(moment: datetime | date) -> datetime:
    """Return the time, or the first moment of the day in UTC."""
    if isinstance(moment, datetime):
        return moment
    return datetime(moment.year, moment.month, moment.day, tzinfo=UTC)
