"""A team's own tokens, over the API; needs a token with the scope `tokens`."""

from collections.abc import Sequence
from typing import Any

from exceptiondrive.transport import Connection, quoted

Record = dict[str, Any]


class TeamTokens(Connection):
    """Lists, issues, rotates and revokes the tokens of one's team; arguments as in `Client`."""

    def all(self) -> list[Record]:
        """Return the team's tokens, newest first, without their secrets."""
        return [dict(token) for token in self._transport.get("/tokens").json()]

    def create(
        self, name: str, scopes: Sequence[str] | None = None, expires_at: str | None = None
    ) -> Record:
        """Issue a token; its text is under `token`, and is shown this once.

        Args:
            name: What it is for.
            scopes: None more than one's own token has; by default `submit` and `read:own`.
            expires_at: ISO 8601 with zone; else it does not expire.
        """
        wanted = {"name": name, "scopes": scopes and list(scopes), "expires_at": expires_at}
        return dict(self._transport.post_once("/tokens", wanted))

    def rotate(self, token_id: str, *, keep_days: int = 7) -> Record:
        """Issue the successor of a token; the old one works on for `keep_days`."""
        path = f"/tokens/{quoted(token_id)}/rotate"
        return dict(self._transport.post_once(path, {"keep_days": keep_days}))

    def revoke(self, token_id: str) -> Record:
        """Revoke a token for good."""
        return dict(self._transport.post_once(f"/tokens/{quoted(token_id)}/revoke", {}))
