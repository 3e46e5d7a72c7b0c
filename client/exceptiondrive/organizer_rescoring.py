"""Protocol updates over the API, for organizers: every step needs a reason."""

from collections.abc import Mapping
from typing import Any
from urllib.parse import quote

from exceptiondrive.transport import Transport

Record = dict[str, Any]


class Rescoring:
    """Speaks to `/organizer/rescoring` of one server.

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
        return dict(self._get(f"/{quote(run_id, safe='')}"))

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
        return self._post(f"/{quote(run_id, safe='')}/{step}", {"reason": reason, **more})

    def preview(self, run_id: str, seen: str | None = None) -> Record:
        """Return the comparison that the next flip would make true."""
        return dict(self._get(f"/{quote(run_id, safe='')}/preview", {"seen": seen}))

    def preview_csv(self, run_id: str) -> str:
        """Return the comparison as CSV."""
        path = f"/organizer/rescoring/{quote(run_id, safe='')}/preview.csv"
        return self._transport.get(path).text

    def start_verification(self, phase: str, sample: int | None, reason: str) -> Record:
        """Ask for sheets to be recomputed from their uploads."""
        wanted = {"phase": phase, "sample": sample, "reason": reason}
        return self._post("/verifications", wanted)

    def verification(self, verification_id: str) -> Record:
        """Return what a verification has come to."""
        return dict(self._get(f"/verifications/{quote(verification_id, safe='')}"))

    def _get(self, path: str, query: Mapping[str, str | None] | None = None) -> Any:
        return self._transport.get(f"/organizer/rescoring{path}", query).json()

    def _post(self, path: str, document: Mapping[str, Any]) -> Record:
        """POST once: a step that was taken cannot be taken again."""
        body = {"json": {key: value for key, value in document.items() if value is not None}}
        whole = f"/organizer/rescoring{path}"
        return dict(self._transport.post(whole, lambda: dict(body), is_repeatable=False).json())
