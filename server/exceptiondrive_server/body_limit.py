"""A hard cap on request bodies: early by Content-Length, and while they stream in.

Starlette has such a middleware, but it replaces our problem document by plain text.
"""

from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from exceptiondrive_schemas.problems import ProblemCode
from exceptiondrive_server.problem_vocabulary import ApiProblem
from exceptiondrive_server.problems import (
    TOO_LARGE,
    problem_response,
)

UPLOAD_PATHS = frozenset({"/api/v1/submissions", "/submit"})
SMALL_BODY_BYTES = 1024 * 1024
"""Everything but an upload: a protocol document is the largest of them."""


class BodyLimit:
    """Refuses bodies above the cap of their address before a byte too many is read."""

    def __init__(self, app: ASGIApp, upload_limit_bytes: int) -> None:
        self.app = app
        self.upload_limit_bytes = upload_limit_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        limit = self.upload_limit_bytes if scope["path"] in UPLOAD_PATHS else SMALL_BODY_BYTES
        refusal = _refusal(Headers(scope=scope).get("content-length"), limit)
        if refusal is not None:
            response = problem_response(Request(scope), refusal)
            response.headers["Connection"] = "close"
            await response(scope, receive, send)
            return
        await self.app(scope, _counted(receive, limit), send)


def _refusal(content_length: str | None, limit_bytes: int) -> ApiProblem | None:
    """Return why a body cannot be taken, going by what its header says."""
    if content_length is None:
        return None
    if not (content_length.isascii() and content_length.isdigit()):
        return ApiProblem(ProblemCode.BAD_REQUEST, "Content-Length must be a number of bytes.")
    is_too_large = len(content_length) > 18 or int(content_length) > limit_bytes
    return ApiProblem(ProblemCode.UPLOAD_TOO_LARGE, TOO_LARGE) if is_too_large else None


def _counted(receive: Receive, limit_bytes: int) -> Receive:
    """Count what really comes: a header may be absent or lie."""
    n_bytes = 0

    async def receive_counted() -> Message:
        nonlocal n_bytes
        message = await receive()
        n_bytes += len(message.get("body", b""))
        if n_bytes > limit_bytes:
            raise HTTPException(413)
        return message

    return receive_counted
