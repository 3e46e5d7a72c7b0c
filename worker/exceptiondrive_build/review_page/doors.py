"""Access to the page: one-time addresses, and sessions of signed-in reviewers."""

import secrets
from collections.abc import Callable

from exceptiondrive_build.review_page.leases import Holder


class Doors:
    """Keys of one process; they end with it, and are never written to disk."""

    def __init__(self, announce: Callable[[str], None]) -> None:
        """Create the first key; it and each later one are announced in the organizer's terminal."""
        self._announce = announce
        self._unused: set[str] = set()
        self._sessions: dict[str, Holder] = {}
        self._announced = ""
        self._announce_next()

    def new_key(self) -> str:
        """Create a key that opens the page once."""
        key = secrets.token_urlsafe(24)
        self._unused.add(key)
        return key

    def _announce_next(self) -> None:
        self._announced = self.new_key()
        self._announce(self._announced)

    def open(self, key: str) -> str | None:
        """Exchange a key for a session; None if it is spent. An announced key gets a successor."""
        if key not in self._unused:
            return None
        self._unused.remove(key)
        session = secrets.token_urlsafe(24)
        self._sessions[session] = Holder(secrets.token_hex(8), "")
        if key == self._announced:
            self._announce_next()
        return session

    def holder(self, session: str | None) -> Holder | None:
        """Return the holder of a session; the name is empty before signing in."""
        return None if session is None else self._sessions.get(session)

    def sign_in(self, session: str, name: str) -> None:
        """Give a session a name; it becomes a new browser, so leases of an earlier name expire."""
        self._sessions[session] = Holder(secrets.token_hex(8), name)

    def sign_out(self, session: str) -> None:
        """End a session."""
        self._sessions.pop(session, None)
