"""Compress responses with gzip, but only public ones.

The length of a compressed response reveals how similar its parts are. If one part is secret and an
attacker chooses another (every page repeats its own address), observed lengths reveal the secret
letter by letter (BREACH). So responses for one reader only (`private`, `no-store`: pages with a form
token, a session or a token; responses to a bearer token) are sent uncompressed.
"""

from starlette.datastructures import Headers, MutableHeaders
from starlette.middleware.gzip import GZipResponder, IdentityResponder
from starlette.types import ASGIApp, Message, Receive, Scope, Send

MINIMUM_BYTES = 1024
LEVEL = 4
"""Half the time of level 6, and five per cent more bytes."""


def takes_gzip(accept_encoding: str) -> bool:
    """Whether an asker takes gzip (RFC 9110 section 12.5.3)."""
    return takes(accept_encoding, "gzip", "*")


def takes(accepted: str, *names: str) -> bool:
    """Whether an asker takes what goes by one of these names in a header (RFC 9110 section 12.4.2)."""
    for part in accepted.lower().split(","):
        name, _, quality = part.partition(";")
        if name.strip() in names:
            return quality.replace(" ", "") not in ("q=0", "q=0.0", "q=0.00", "q=0.000")
    return False


class PublicCompression:
    """Compresses what is public; event streams, pictures and fonts stay as they are."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request."""
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        packs = takes_gzip(Headers(scope=scope).get("accept-encoding", ""))
        responder = IdentityResponder(self.app, MINIMUM_BYTES)
        if packs:
            responder = GZipResponder(self.app, MINIMUM_BYTES, compresslevel=LEVEL)
        is_private = False

        async def send_as_public(message: Message) -> None:
            nonlocal is_private
            if message["type"] == "http.response.start":
                headers = MutableHeaders(raw=message["headers"])
                caches = headers.get("cache-control", "")
                is_private = "private" in caches or "no-store" in caches
                if message["status"] == 304 and not is_private:
                    _say_that_it_varies(headers)
            await (send if is_private else responder.send_with_compression)(message)

        responder.send = _weakening(send) if packs else send
        await self.app(scope, receive, send_as_public)


def _say_that_it_varies(headers: MutableHeaders) -> None:
    """Add `Vary` to a 304, as to its 200 (RFC 9110 15.4.5)."""
    if "accept-encoding" not in headers.get("vary", "").lower():
        headers.add_vary_header("Accept-Encoding")


def _weakening(send: Send) -> Send:
    """The ETag of a compressed answer is weak: other bytes carry the same one (RFC 9110 8.8.3)."""

    async def send_weakened(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(raw=message["headers"])
            is_of_packed = headers.get("content-encoding") == "gzip" or message["status"] == 304
            if is_of_packed and headers.get("etag", "").startswith('"'):
                headers["ETag"] = f"W/{headers['etag']}"
        await send(message)

    return send_weakened
