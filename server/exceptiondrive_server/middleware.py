"""Around every request: an id, one log line, security headers. Never a token, never a body."""

import re
import time
import uuid

import structlog
from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from exceptiondrive_server.metrics import REQUEST_SECONDS

_log = structlog.get_logger("exceptiondrive.access")
_ID = re.compile(r"[A-Za-z0-9._-]{8,64}")

HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
        "font-src 'self'; connect-src 'self'; form-action 'self'; base-uri 'none'; "
        "frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
}


class RequestContext:
    """Gives each request an id, which the answer and the log line carry."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        request_id = _request_id(Headers(scope=scope).get("x-request-id", ""))
        scope.setdefault("state", {})["request_id"] = request_id
        started, status = time.perf_counter(), 500

        async def send_with_headers(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                headers = MutableHeaders(scope=message)
                headers["X-Request-ID"] = request_id
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        structlog.contextvars.bind_contextvars(request_id=request_id)
        try:
            await self.app(scope, receive, send_with_headers)
        finally:
            _note(scope, status, time.perf_counter() - started)
            structlog.contextvars.clear_contextvars()


def _request_id(offered: str) -> str:
    """Take over a proxy's id if it is plain, else make one."""
    return offered if _ID.fullmatch(offered) else uuid.uuid4().hex


def _note(scope: Scope, status: int, seconds: float) -> None:
    route = scope.get("route")
    path = getattr(route, "path", "unmatched")
    REQUEST_SECONDS.labels(scope["method"], path, str(status)).observe(seconds)
    _log.info(
        "request",
        method=scope["method"],
        route=path,
        status=status,
        duration_ms=round(seconds * 1000, 1),
    )
