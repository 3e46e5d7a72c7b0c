"""What an organizer's token may do: teams, tokens, phases, protocols, splits, audit.

Answers are JSON objects as the API documents them (`/api/v1/docs`, tag `organizers`).
"""

from collections.abc import Mapping
from typing import Any, Self
from urllib.parse import quote

from exceptiondrive.credentials import find_server, find_token, normal_server
from exceptiondrive.organizer_rescoring import Rescoring
from exceptiondrive.transport import Transport

Record = dict[str, Any]


class Organizer:
    """Speaks for an organizer to one server; server and token as in `Client`."""

    def __init__(self, server: str | None = None, token: str | None = None) -> None:
        self.server = normal_server(server) if server else find_server()
        self._transport = Transport(self.server, token or find_token(self.server))
        self.rescoring = Rescoring(self._transport)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._transport.close()

    def teams(self) -> list[Record]:
        """Return all teams."""
        return self._list("/organizer/teams")

    def create_team(self, team_id: str, name: str, *, is_reference: bool = False) -> Record:
        """Make a team; a reference team's entries are shown and never ranked."""
        team = {"id": team_id, "name": name, "is_reference": is_reference}
        return self._create("/organizer/teams", team)

    def approve_team(self, team_id: str) -> Record:
        """Let a team that registered itself submit."""
        return self._create(f"/organizer/teams/{quote(team_id, safe='')}/approve", {})

    def refuse_team(self, team_id: str, reason: str) -> Record:
        """Refuse a team that registered itself: it goes, with its tokens."""
        path = f"/organizer/teams/{quote(team_id, safe='')}/refuse"
        return self._create(path, {"reason": reason})

    def retry_submission(self, submission_id: str, reason: str) -> Record:
        """Queue a failed submission again, with all its attempts."""
        path = f"/organizer/submissions/{quote(submission_id, safe='')}/retry"
        return self._create(path, {"reason": reason})

    def tokens(self, team_id: str) -> list[Record]:
        """Return a team's tokens, without their secrets."""
        return self._list(f"/organizer/teams/{quote(team_id, safe='')}/tokens")

    def issue_token(self, team_id: str, name: str, expires_at: str | None = None) -> Record:
        """Issue a token; its text is under `token`, and is shown this once."""
        path = f"/organizer/teams/{quote(team_id, safe='')}/tokens"
        return self._create(path, {"name": name, "expires_at": expires_at})

    def revoke_token(self, token_id: str) -> Record:
        """Revoke a token for good."""
        return self._create(f"/organizer/tokens/{quote(token_id, safe='')}/revoke", {})

    def splits(self) -> list[Record]:
        """Return the registered split revisions."""
        return self._list("/organizer/splits")

    def create_phase(self, phase: Mapping[str, Any]) -> Record:
        """Make a phase: `id`, `challenge`, `title`, `split`, `protocol` and what may be set."""
        return self._create("/organizer/phases", dict(phase))

    def phase(self, phase_id: str) -> Record:
        """Return a phase: its settings and where it stands."""
        return self._object(self._transport.get(f"/phases/{quote(phase_id, safe='')}").json())

    def change_phase(self, phase_id: str, changes: Mapping[str, Any]) -> Record:
        """Change settings of a phase; what is left out stays, None takes a limit or date away."""
        path = f"/organizer/phases/{quote(phase_id, safe='')}"
        body = {"json": dict(changes)}
        return self._object(self._transport.patch(path, lambda: dict(body)).json())

    def similar(self, phase_id: str) -> Record:
        """Return which submissions of a phase are alike, and which teams may be probing."""
        path = f"/organizer/phases/{quote(phase_id, safe='')}/similar"
        return self._object(self._transport.get(path).json())

    def freeze_phase(self, phase_id: str, reason: str) -> Record:
        """Freeze the public board now; scoring goes on."""
        path = f"/organizer/phases/{quote(phase_id, safe='')}/freeze"
        return self._create(path, {"reason": reason})

    def reveal_phase(self, phase_id: str, what: str, reason: str) -> Record:
        """Show the board behind a freeze, the names, or begin to score the revealed part."""
        path = f"/organizer/phases/{quote(phase_id, safe='')}/reveal"
        return self._create(path, {"what": what, "reason": reason})

    def protocols(self) -> list[Record]:
        """Return all protocols, oldest first."""
        return self._list("/protocols")

    def add_protocol(self, toml: str) -> Record:
        """Add a protocol document; it is immutable from then on."""
        body = {"content": toml.encode(), "headers": {"content-type": "application/toml"}}
        return self._object(self._transport.post("/organizer/protocols", lambda: dict(body)).json())

    def audit(self, limit: int = 100) -> list[Record]:
        """Return the newest lines of the audit log."""
        found = self._transport.get("/organizer/audit", {"limit": str(limit)}).json()
        return [self._object(item) for item in found]

    def verify_audit(self, head: str | None = None) -> Record:
        """Recompute the chain of the audit log; look for the head that was kept earlier."""
        query = {"head": head}
        return self._object(self._transport.get("/organizer/audit/verify", query).json())

    def _list(self, path: str) -> list[Record]:
        return [self._object(item) for item in self._transport.get(path).json()]

    def _create(self, path: str, document: Mapping[str, Any]) -> Record:
        """POST once: what is made twice would be two."""
        arguments = {"json": {key: value for key, value in document.items() if value is not None}}
        response = self._transport.post(path, lambda: dict(arguments), is_repeatable=False)
        return self._object(response.json())

    def _object(self, value: Any) -> Record:
        return dict(value)
