"""A hard cap on request bodies: early by Content-Length, and while they stream in.

Starlette has such a middleware, but it replaces our problem document by plain text.
"""

from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from exceptiondrive_schemas.problems import ProblemCode
from exceptiondrive_server.web.problem_vocabulary import ApiProblem
from exceptiondrive_server.web.problems import TOO_LARGE, problem_response

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


# Sheds uploads beyond what one process can take at once, so that pages stay quick.
#
# Who is sent away is told when to come again; nothing was taken, so nothing is lost.


RETRY_AFTER_S = 5


class Overload:
    """Answers 503 with `Retry-After` while `at_once` uploads are under way in this process."""

    def __init__(self, app: ASGIApp, at_once: int) -> None:
        self.app = app
        self.at_once = at_once
        self._under_way = 0

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request."""
        if not _is_upload(scope):
            await self.app(scope, receive, send)
            return
        if self._under_way >= self.at_once:
            detail = "Many files arrive right now. Nothing was taken; send it again shortly."
            problem = ApiProblem(ProblemCode.STORE_UNAVAILABLE, detail, retry_after_s=RETRY_AFTER_S)
            response = problem_response(Request(scope), problem)
            response.headers["Connection"] = "close"
            await response(scope, receive, send)
            return
        self._under_way += 1
        try:
            await self.app(scope, receive, send)
        finally:
            self._under_way -= 1


def _is_upload(scope: Scope) -> bool:
    is_post = scope["type"] == "http" and scope["method"] == "POST"
    return is_post and str(scope["path"]) in UPLOAD_PATHS
