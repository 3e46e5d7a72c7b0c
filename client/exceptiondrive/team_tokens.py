"""A team's own tokens, over the API; needs a token with the scope `tokens`."""

from collections.abc import Sequence
from typing import Any, Self
from urllib.parse import quote

from exceptiondrive.credentials import find_server, find_token, normal_server
from exceptiondrive.transport import Transport

Record = dict[str, Any]


class TeamTokens:
    """Lists, issues, rotates and revokes the tokens of one's team; arguments as in `Client`."""

    def __init__(self, server: str | None = None, token: str | None = None) -> None:
        self.server = normal_server(server) if server else find_server()
        self._transport = Transport(self.server, token or find_token(self.server))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._transport.close()

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
        return self._post("", {key: value for key, value in wanted.items() if value is not None})

    def rotate(self, token_id: str, *, keep_days: int = 7) -> Record:
        """Issue the successor of a token; the old one works on for `keep_days`."""
        return self._post(f"/{quote(token_id, safe='')}/rotate", {"keep_days": keep_days})

    def revoke(self, token_id: str) -> Record:
        """Revoke a token for good."""
        return self._post(f"/{quote(token_id, safe='')}/revoke", None)

    def _post(self, path: str, document: Record | None) -> Record:
        """POST once: what is issued twice would be two tokens."""
        arguments = {} if document is None else {"json": document}
        answer = self._transport.post(
            f"/tokens{path}", lambda: dict(arguments), is_repeatable=False
        )
        return dict(answer.json())
