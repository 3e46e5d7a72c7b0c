"""Limits on the size of a request's head and body, and on how slowly a body may arrive.

In production nginx disconnects slow clients first (deploy/nginx.conf). Without it, a head that never
ends keeps its connection open.
"""

import asyncio
import time
from contextlib import suppress

from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import PlainTextResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from exceptiondrive_schemas.api.problems import ProblemCode
from exceptiondrive_server.web.problem_vocabulary import ApiProblem
from exceptiondrive_server.web.problems import TOO_LARGE, problem_response

UPLOAD_PATHS = frozenset({"/api/v1/submissions", "/submit"})
SMALL_BODY_BYTES = 1024 * 1024
"""Everything but an upload: a protocol document is the largest of them."""
HEAD_BYTES = 32 * 1024
BODY_S = 30.0
"""How long a body may be waited for, and longer as long as `BODY_BYTES_PER_S` keep coming."""
BODY_BYTES_PER_S = 16 * 1024
HEAD_TOO_LARGE = "The headers of the request are too large."
TOO_SLOW = "The request took too long to arrive; send it again."


class RequestLimits:
    """Refuses a head or body that is too large or too slow, before a byte too many is read.

    Starlette limits bodies, too, but answers in plain text where ours is a problem document.
    """

    def __init__(self, app: ASGIApp, upload_limit_bytes: int) -> None:
        self.app = app
        self.upload_limit_bytes = upload_limit_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        limit = self.upload_limit_bytes if scope["path"] in UPLOAD_PATHS else SMALL_BODY_BYTES
        refusal = _refusal(scope, limit)
        if refusal is not None:
            refusal.headers["Connection"] = "close"
            await refusal(scope, receive, send)
            return
        body = _Body(scope, receive, send, limit)
        with suppress(ClientDisconnect):  # nobody is left to be answered
            await self.app(scope, body.receive, body.send)


def _refusal(scope: Scope, limit_bytes: int) -> Response | None:
    """Return why a request cannot be taken, going by its head."""
    head_bytes = len(scope.get("raw_path", b"")) + len(scope["query_string"])
    if head_bytes + sum(len(name) + len(value) for name, value in scope["headers"]) > HEAD_BYTES:
        return PlainTextResponse(HEAD_TOO_LARGE, 431)
    length = Headers(scope=scope).get("content-length", "0")
    if not (length.isascii() and length.isdigit()):
        problem = ApiProblem(ProblemCode.BAD_REQUEST, "Content-Length must be a number of bytes.")
        return problem_response(Request(scope), problem)
    if len(length) > 18 or int(length) > limit_bytes:
        return problem_response(Request(scope), ApiProblem(ProblemCode.UPLOAD_TOO_LARGE, TOO_LARGE))
    return None


class _Body:
    """A body as it comes: counted, since a header may be absent or lie, and timed."""

    def __init__(self, scope: Scope, receive: Receive, send: Send, limit_bytes: int) -> None:
        self._scope, self._receive, self._send = scope, receive, send
        self._limit_bytes = limit_bytes
        self._n_bytes = 0
        self._waited_s = 0.0
        """While somebody read: what we do with a part of the body is not its sender's time."""
        self._is_whole = False
        self._is_answered = False
        self._is_ended = False

    async def receive(self) -> Message:
        """Return the next part; the sender who is too slow has hung up."""
        if self._is_whole:
            return await self._receive()
        left_s = BODY_S + self._n_bytes / BODY_BYTES_PER_S - self._waited_s
        began_s = time.monotonic()
        try:
            async with asyncio.timeout(left_s):
                message = await self._receive()
        except TimeoutError:
            await self._end()
            return {"type": "http.disconnect"}
        self._waited_s += time.monotonic() - began_s
        self._n_bytes += len(message.get("body", b""))
        self._is_whole = not message.get("more_body", False)
        if self._n_bytes > self._limit_bytes:
            raise HTTPException(413)
        return message

    async def send(self, message: Message) -> None:
        """Answer; after too large a body the connection is of no more use."""
        if self._is_ended:
            return
        self._is_answered = True
        if message["type"] == "http.response.start" and self._n_bytes > self._limit_bytes:
            MutableHeaders(scope=message)["Connection"] = "close"
        await self._send(message)

    async def _end(self) -> None:
        if not self._is_answered:
            answer = PlainTextResponse(TOO_SLOW, 408, headers={"Connection": "close"})
            await answer(self._scope, self._receive, self._send)
        self._is_ended = True
