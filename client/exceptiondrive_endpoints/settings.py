"""What is written down of an endpoint, checked before it is asked."""

import json
from collections.abc import Mapping
from typing import Any
from urllib.parse import urlsplit


def checked_address(text: str) -> str:
    """Return the address of an endpoint.

    Raises:
        ValueError: Not http(s), no host, no port, or it carries a password, which would be kept
            where addresses are kept.
    """
    try:
        address = urlsplit(text)
        is_one = address.scheme in ("http", "https") and address.hostname and address.port != 0
    except ValueError:  # brackets that do not close, a port that is none
        is_one = False
    if not is_one or not text.isprintable() or " " in text:
        raise ValueError(f"expected http://... or https://..., got {text!r}")
    if address.username or address.password:
        raise ValueError("no user or password in it")
    return text


def checked_fields(fields: Mapping[str, Any]) -> dict[str, Any]:
    """Return further fields of a request.

    Raises:
        ValueError: JSON cannot hold one: a number that is not finite, a date.
    """
    try:
        json.dumps(fields, allow_nan=False)
    except (TypeError, ValueError, RecursionError) as error:
        raise ValueError(f"JSON cannot hold it: {error}") from None
    return dict(fields)
