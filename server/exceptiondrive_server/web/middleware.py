"""Middleware of every request: an id, one log line (without token or body), security headers."""

import re
import time
import uuid
from collections.abc import Mapping

import structlog
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from exceptiondrive_server.web.metrics import RequestMetrics

# Headers that every answer carries (docs/trust.md).


HEADERS: Mapping[str, str] = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
        "font-src 'self'; connect-src 'self'; form-action 'self'; base-uri 'none'; "
        "frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
}


_log = structlog.get_logger("exceptiondrive.access")
_ID = re.compile(r"[A-Za-z0-9._-]{8,64}")
_LEFT = 499
"""The sender left before there was an answer: counted as nginx counts it, and no error of ours."""
_METHODS = frozenset({"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"})


class RequestContext:
    """Gives each request an id, which the answer and the log line carry."""

    def __init__(self, app: ASGIApp, metrics: RequestMetrics) -> None:
        self.app = app
        self.metrics = metrics

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        asked = Headers(scope=scope)
        request_id = _request_id(asked.get("x-request-id", ""))
        scope.setdefault("state", {})["request_id"] = request_id
        started, status = time.perf_counter(), _LEFT

        async def send_with_headers(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                _add_headers(MutableHeaders(scope=message), asked, request_id)
            await send(message)

        with structlog.contextvars.bound_contextvars(request_id=request_id):
            try:
                await self.app(scope, receive, send_with_headers)
            except Exception:
                status = 500
                raise
            finally:
                self._note(scope, status, time.perf_counter() - started)

    def _note(self, scope: Scope, status: int, seconds: float) -> None:
        """Log and count by route, not by address: addresses hold what people send."""
        method = scope["method"] if scope["method"] in _METHODS else "other"
        route = route_of(scope)
        self.metrics.observe(method, route, status, seconds)
        _log.info(
            "request",
            method=method,
            route=route,
            status=status,
            duration_ms=round(seconds * 1000, 1),
        )


def route_of(scope: Scope) -> str:
    """Return the template of the address, such as `/api/v1/entries/{submission_id}`."""
    included = scope.get("fastapi", {}).get("effective_route_context")  # knows the prefixes
    found = included or scope.get("route")
    if found is None:
        return "unmatched"
    return str(getattr(found, "path_format", None) or getattr(found, "path", "mounted"))


def _request_id(offered: str) -> str:
    """Take over a proxy's id if it is plain, else make one."""
    return offered if _ID.fullmatch(offered) else uuid.uuid4().hex


def _add_headers(headers: MutableHeaders, asked: Headers, request_id: str) -> None:
    headers["X-Request-ID"] = request_id
    for name, value in HEADERS.items():
        headers.setdefault(name, value)
    is_personal = "authorization" in asked or "cookie" in asked
    headers.setdefault("Cache-Control", "no-store" if is_personal else "no-cache")


# HEAD wherever GET is answered: the same headers, no body (RFC 9110 section 9.3.2).


class HeadRequests:
    """Answers HEAD as GET and keeps the body back."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request; an event stream has no end, so its HEAD stays a 405."""
        if scope["type"] != "http" or scope["method"] != "HEAD" or is_stream(scope["path"]):
            await self.app(scope, receive, send)
            return

        async def send_head(message: Message) -> None:
            if message["type"] == "http.response.body":
                message = {**message, "body": b""}
            await send(message)

        await self.app({**scope, "method": "GET"}, receive, send_head)


def is_stream(path: str) -> bool:
    """Whether an answer has no end."""
    return path.endswith("/events")
