"""Strong ETags: the digest of the bytes, and 304 where the asker has them."""

import hashlib

from fastapi import Request
from fastapi.responses import Response

FOR_EVER_S = 31_536_000
"""A year: for what never changes at its address."""


def conditional(request: Request, body: bytes, media_type: str, *, max_age_s: int) -> Response:
    """Answer with the body, or with 304 if the asker's copy is the same."""
    etag = f'"{hashlib.sha256(body).hexdigest()}"'
    fresh = "immutable" if max_age_s == FOR_EVER_S else "stale-while-revalidate=60"
    headers = {"ETag": etag, "Cache-Control": f"public, max-age={max_age_s}, {fresh}"}
    if matches(request.headers.get("if-none-match"), etag):
        return Response(status_code=304, headers=headers)
    return Response(body, media_type=media_type, headers=headers)


def matches(if_none_match: str | None, etag: str) -> bool:
    """Whether an If-None-Match header names this ETag (RFC 9110 section 13.1.2, weak comparison)."""
    if if_none_match is None:
        return False
    names = {name.strip().removeprefix("W/") for name in if_none_match.split(",")}
    return etag in names or "*" in names
