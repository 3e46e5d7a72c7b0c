"""What a ring looks like: the message by which the doorbell calls a worker, and nothing else.

Celery trusts what lies in its queues. Anything else in there is junk: another program's data, a
slip at the broker's prompt, a message damaged on its way. It is told apart here, before Celery sees
it. The fields are those of Celery's message protocol 2 in kombu's envelope.
"""

import base64
from typing import Annotated, Literal

from kombu.utils.encoding import bytes_to_str
from kombu.utils.json import loads
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

from exceptiondrive_schemas.jobs import JobName

MAX_RING_BYTES = 16 * 1024
"""A ring holds ids and has about 900 bytes."""

_Nothing = Annotated[dict[str, object], Field(max_length=0)]
_Body = TypeAdapter(
    tuple[Annotated[list[str], Field(min_length=1, max_length=3)], _Nothing, dict[str, None]]
)
"""Ids, no named arguments, and no job that is to follow."""


class _Part(BaseModel):
    """Further fields may be there: newer releases of Celery add some."""

    model_config = ConfigDict(strict=True)


class _Delivery(_Part):
    exchange: str
    routing_key: str


class _Properties(_Part):
    delivery_tag: str
    delivery_info: _Delivery
    body_encoding: Literal["base64"]


class _Headers(_Part):
    """Which job, now and within the usual limits: no later time, no limit of its own."""

    id: str
    task: Annotated[JobName, Field(strict=False)]
    eta: None = None
    expires: None = None
    compression: None = None
    shadow: None = None
    timelimit: list[None] = []


class _Envelope(_Part):
    body: str
    content_type: Annotated[Literal["application/json"], Field(alias="content-type")]
    content_encoding: Annotated[Literal["utf-8"], Field(alias="content-encoding")]
    headers: _Headers
    properties: _Properties


def why_no_ring(message: bytes) -> str | None:
    """Say why a message is no ring, in words that quote nothing of it; None for a ring."""
    if len(message) > MAX_RING_BYTES:
        return f"it has more than {MAX_RING_BYTES} bytes"
    try:
        document = loads(bytes_to_str(message))  # as kombu reads it, so that kombu can
    except (ValueError, TypeError, AttributeError, ArithmeticError, RecursionError):
        return "it is not JSON"
    try:
        envelope = _Envelope.model_validate(document)
    except ValueError:
        return "it is not an envelope of a known job"
    try:
        _Body.validate_json(base64.b64decode(envelope.body, validate=True), strict=True)
    except ValueError:
        return "its body is not a list of ids"
    return None
