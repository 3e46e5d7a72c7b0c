"""Strong ETags: the digest of the response, and 304 if the client has it."""

import hashlib
from collections.abc import Callable, Mapping
from typing import Any

from fastapi import Request
from fastapi.responses import Response

PROXY_KEEPS_S = 5
"""How long the proxy may show to everybody what can be taken back: hidden, forgotten, removed."""
PROXY_KEEPS = {"X-Accel-Expires": str(PROXY_KEEPS_S)}
"""No browser sees it. Stands first: nginx before 1.23 obeys the first of two that say how long.

A 404 has it, too: it takes the place of what stood at its address, which would be shown again while no
server answers.
"""
REVALIDATED = {**PROXY_KEEPS, "Cache-Control": "no-cache"}
"""For what never changes at its address, but may be taken back: browsers ask, and get a 304."""

UNCHANGED: dict[str, Any] = {"description": "The asker's copy is the current one."}
"""How OpenAPI describes the 304 of a route that answers by `conditional`."""


def conditional(
    request: Request,
    body: bytes | Callable[[], bytes],
    media_type: str,
    *,
    etag: str = "",
    max_age_s: int | None = None,
    headers: Mapping[str, str] | None = None,
) -> Response:
    """Respond with the body, or with 304 if the client's copy is the same.

    A body that is expensive to make is a function, called only if needed. `etag` identifies it, by
    default its digest. Without `max_age_s` the headers say for how long caches may keep it.
    """
    if not etag:
        body = body() if callable(body) else body
        etag = hashlib.sha256(body).hexdigest()
    tagged = {**(headers or {}), "ETag": f'"{etag}"'}
    if max_age_s is not None:
        tagged["Cache-Control"] = f"public, max-age={max_age_s}, stale-while-revalidate=60"
    if tagged.get("Cache-Control", "").startswith("public"):
        tagged = {**PROXY_KEEPS, **tagged}
    if _matches(request.headers.get("if-none-match"), tagged["ETag"]):
        return Response(status_code=304, headers=tagged)
    made = body() if callable(body) else body
    return Response(made, media_type=media_type, headers=tagged)


def _matches(if_none_match: str | None, etag: str) -> bool:
    """Whether an If-None-Match header names this ETag (RFC 9110 section 13.1.2, weak comparison)."""
    names = {name.strip().removeprefix("W/") for name in (if_none_match or "").split(",")}
    return etag in names or "*" in names
