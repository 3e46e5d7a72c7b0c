"""Slots for pages: however many are requested, threads remain for teams and monitors."""

from weakref import WeakValueDictionary

from anyio import CapacityLimiter
from starlette.types import ASGIApp, Message, Receive, Scope, Send

PAGES_AT_ONCE = 4
"""In a process. Each takes a thread of the forty, and its turns at the interpreter."""
PAGES_OF_AN_ADDRESS = 2
"""Of them: whoever asks for many pages at once waits behind none but its own."""
_NO_PAGES = ("/api/", "/healthz", "/readyz", "/metrics", "/static/")


class PagePlaces:
    """Limits concurrent rendering of pages; waiting holds no thread. A slot is free once its response begins."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app
        self._places = CapacityLimiter(PAGES_AT_ONCE)
        self._of_address: WeakValueDictionary[str, CapacityLimiter] = WeakValueDictionary()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one request."""
        is_page = scope["type"] == "http" and scope["method"] in ("GET", "HEAD")
        if not is_page or scope["path"].startswith(_NO_PAGES):
            await self.app(scope, receive, send)
            return
        holder, held = object(), list[CapacityLimiter]()

        def leave() -> None:
            while held:
                held.pop().release_on_behalf_of(holder)

        async def send_and_leave(message: Message) -> None:
            leave()  # it is made: who reads slowly keeps nobody waiting
            await send(message)

        address = (scope.get("client") or ("",))[0]
        own = self._of_address.setdefault(address, CapacityLimiter(PAGES_OF_AN_ADDRESS))
        try:
            for places in (own, self._places):
                await places.acquire_on_behalf_of(holder)
                held.append(places)
            await self.app(scope, receive, send_and_leave)
        finally:
            leave()
