"""What an organizer's token may do: teams, tokens, phases, protocols, rescoring, splits, audit.

Answers are JSON objects as the API documents them (`/api/v1/docs`, tag `organizers`).
"""

from collections.abc import Mapping
from typing import Any

from exceptiondrive.transport import Connection, Transport, quoted

Record = dict[str, Any]


class Organizer(Connection):
    """Speaks for an organizer to one server; server and token as in `Client`."""

    @property
    def rescoring(self) -> "Rescoring":
        """Protocol updates, each step with its reason."""
        return Rescoring(self._transport)

    def teams(self) -> list[Record]:
        """Return all teams."""
        return self._list("/organizer/teams")

    def create_team(self, team_id: str, name: str, *, is_reference: bool = False) -> Record:
        """Make a team; a reference team's entries are shown and never ranked."""
        team = {"id": team_id, "name": name, "is_reference": is_reference}
        return self._create("/organizer/teams", team)

    def approve_team(self, team_id: str) -> Record:
        """Let a team that registered itself submit."""
        return self._create(f"/organizer/teams/{quoted(team_id)}/approve", {})

    def refuse_team(self, team_id: str, reason: str) -> Record:
        """Refuse a team that registered itself: it goes, with its tokens."""
        path = f"/organizer/teams/{quoted(team_id)}/refuse"
        return self._create(path, {"reason": reason})

    def retry_submission(self, submission_id: str, reason: str) -> Record:
        """Queue a failed submission again, with all its attempts."""
        path = f"/organizer/submissions/{quoted(submission_id)}/retry"
        return self._create(path, {"reason": reason})

    def tokens(self, team_id: str) -> list[Record]:
        """Return a team's tokens, without their secrets."""
        return self._list(f"/organizer/teams/{quoted(team_id)}/tokens")

    def issue_token(self, team_id: str, name: str, expires_at: str | None = None) -> Record:
        """Issue a token; its text is under `token`, and is shown this once."""
        path = f"/organizer/teams/{quoted(team_id)}/tokens"
        return self._create(path, {"name": name, "expires_at": expires_at})

    def revoke_token(self, token_id: str) -> Record:
        """Revoke a token for good."""
        return self._create(f"/organizer/tokens/{quoted(token_id)}/revoke", {})

    def splits(self) -> list[Record]:
        """Return the registered split revisions."""
        return self._list("/organizer/splits")

    def create_phase(self, phase: Mapping[str, Any]) -> Record:
        """Make a phase: `id`, `challenge`, `title`, `split`, `protocol` and what may be set."""
        return self._create("/organizer/phases", dict(phase))

    def phase(self, phase_id: str) -> Record:
        """Return a phase: its settings and where it stands."""
        return dict(self._transport.get(f"/phases/{quoted(phase_id)}").json())

    def change_phase(self, phase_id: str, changes: Mapping[str, Any]) -> Record:
        """Change settings of a phase; what is left out stays, None takes a limit or date away."""
        path = f"/organizer/phases/{quoted(phase_id)}"
        body = {"json": dict(changes)}
        return dict(self._transport.patch(path, lambda: dict(body)).json())

    def similar(self, phase_id: str) -> Record:
        """Return which submissions of a phase are alike, and which teams may be probing."""
        path = f"/organizer/phases/{quoted(phase_id)}/similar"
        return dict(self._transport.get(path).json())

    def freeze_phase(self, phase_id: str, reason: str) -> Record:
        """Freeze the public board now; scoring goes on."""
        path = f"/organizer/phases/{quoted(phase_id)}/freeze"
        return self._create(path, {"reason": reason})

    def reveal_phase(self, phase_id: str, what: str, reason: str) -> Record:
        """Show the board behind a freeze, the names, or begin to score the revealed part."""
        path = f"/organizer/phases/{quoted(phase_id)}/reveal"
        return self._create(path, {"what": what, "reason": reason})

    def protocols(self) -> list[Record]:
        """Return all protocols, oldest first."""
        return self._list("/protocols")

    def add_protocol(self, toml: str) -> Record:
        """Add a protocol document; it is immutable from then on."""
        body = {"content": toml.encode(), "headers": {"content-type": "application/toml"}}
        return dict(self._transport.post("/organizer/protocols", lambda: dict(body)).json())

    def audit(self, limit: int = 100) -> list[Record]:
        """Return the newest lines of the audit log."""
        found = self._transport.get("/organizer/audit", {"limit": str(limit)}).json()
        return [dict(item) for item in found]

    def verify_audit(self, head: str | None = None) -> Record:
        """Recompute the chain of the audit log; look for the head that was kept earlier."""
        query = {"head": head}
        return dict(self._transport.get("/organizer/audit/verify", query).json())

    def _list(self, path: str) -> list[Record]:
        return [dict(item) for item in self._transport.get(path).json()]

    def _create(self, path: str, document: Mapping[str, Any]) -> Record:
        return dict(self._transport.post_once(path, document))


class Rescoring:
    """Protocol updates: speaks to `/organizer/rescoring` of one server; each step needs a reason.

    Args:
        transport: Of an `Organizer`.
    """

    def __init__(self, transport: Transport) -> None:
        self._transport = transport

    def check_protocol(self, toml: str, phase: str | None = None) -> Record:
        """Validate a protocol document and return what it changes; nothing is kept."""
        arguments = {
            "content": toml.encode(),
            "headers": {"content-type": "application/toml"},
            "params": {} if phase is None else {"phase": phase},
        }
        path = "/organizer/protocols/check"
        return dict(self._transport.post(path, lambda: dict(arguments)).json())

    def runs(self, phase: str | None = None) -> list[Record]:
        """Return runs, newest first."""
        return [dict(item) for item in self._get("", {"phase": phase})]

    def run(self, run_id: str) -> Record:
        """Return one run."""
        return dict(self._get(f"/{quoted(run_id)}"))

    def draft(
        self, phase: str, protocol: str | None, split_revision: str | None, reason: str
    ) -> Record:
        """Draft a run to a protocol, a split revision, or both."""
        wanted = {
            "phase": phase,
            "protocol": protocol,
            "split_revision": split_revision,
            "reason": reason,
        }
        return self._post("", wanted)

    def step(self, run_id: str, step: str, reason: str, **more: str) -> Record:
        """Take a step: start, pause, resume, apply, cancel, rollback or close."""
        return self._post(f"/{quoted(run_id)}/{step}", {"reason": reason, **more})

    def preview(self, run_id: str, seen: str | None = None) -> Record:
        """Return the comparison that the next flip would make true."""
        return dict(self._get(f"/{quoted(run_id)}/preview", {"seen": seen}))

    def preview_csv(self, run_id: str) -> str:
        """Return the comparison as CSV."""
        path = f"/organizer/rescoring/{quoted(run_id)}/preview.csv"
        return self._transport.get(path).text

    def start_verification(self, phase: str, sample: int | None, reason: str) -> Record:
        """Ask for sheets to be recomputed from their uploads."""
        wanted = {"phase": phase, "sample": sample, "reason": reason}
        return self._post("/verifications", wanted)

    def verification(self, verification_id: str) -> Record:
        """Return what a verification has come to."""
        return dict(self._get(f"/verifications/{quoted(verification_id)}"))

    def _get(self, path: str, query: Mapping[str, str | None] | None = None) -> Any:
        return self._transport.get(f"/organizer/rescoring{path}", query).json()

    def _post(self, path: str, document: Mapping[str, Any]) -> Record:
        return dict(self._transport.post_once(f"/organizer/rescoring{path}", document))
