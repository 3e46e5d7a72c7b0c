"""Places for pages: however many are asked for, requests of teams and of monitors find a thread."""

from anyio import CapacityLimiter
from starlette.types import ASGIApp, Message, Receive, Scope, Send

PAGES_AT_ONCE = 4
"""In a process. Each takes a thread of the forty, and its turns at the interpreter."""
_NO_PAGES = ("/api/", "/healthz", "/readyz", "/metrics", "/static/")


class PagePlaces:
    """Lets a few pages be made at once; who waits holds no thread. A place is free as its answer begins."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app
        self._places = CapacityLimiter(PAGES_AT_ONCE)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request."""
        is_page = scope["type"] == "http" and scope["method"] in ("GET", "HEAD")
        if not is_page or scope["path"].startswith(_NO_PAGES):
            await self.app(scope, receive, send)
            return
        holder, is_held = object(), False

        def leave() -> None:
            nonlocal is_held
            if is_held:
                is_held = False
                self._places.release_on_behalf_of(holder)

        async def send_and_leave(message: Message) -> None:
            leave()  # it is made: who reads slowly keeps nobody waiting
            await send(message)

        await self._places.acquire_on_behalf_of(holder)
        is_held = True
        try:
            await self.app(scope, receive, send_and_leave)
        finally:
            leave()
