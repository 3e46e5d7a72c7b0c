"""The clients of the drill: a team that submits, an organizer who steers, anyone who reads."""

import hashlib
import json
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Self

import httpx

from benchmarks.rescore_drill.stage import PHASE

_REASON = {"reason": "drill"}


class Clients:
    """Both sides of the API; an error ends the drill."""

    def __init__(self, url: str, tokens: dict[str, str], files: Iterator[bytes]) -> None:
        self._files = files
        self.n_submitted = 0
        self._clients = {
            who: httpx.Client(
                base_url=f"{url}/api/v1",
                headers={"Authorization": f"Bearer {token}"},
                timeout=60,
            )
            for who, token in tokens.items()
        }

    def organize(self, method: str, path: str, **more: Any) -> Any:
        """Ask as organizer."""
        answer = self._clients["organizer"].request(method, f"/organizer{path}", **more)
        if answer.is_error:
            raise RuntimeError(f"{path}: {answer.status_code} {answer.text}")
        return answer.json()

    def step(self, run_id: str, what: str, **more: str) -> Any:
        """Take one step of a run."""
        return self.organize("POST", f"/rescoring/{run_id}/{what}", json={**_REASON, **more})

    def run(self, run_id: str) -> Any:
        """Return a run as it stands."""
        return self.organize("GET", f"/rescoring/{run_id}")

    def draft(self, version: str) -> Any:
        """Draft a run to a protocol."""
        wanted = {"phase": PHASE, "protocol": version, **_REASON}
        return self.organize("POST", "/rescoring", json=wanted)

    def add_protocol(self, toml: str) -> None:
        """Record a protocol."""
        headers = {"content-type": "application/toml"}
        self.organize("POST", "/protocols", content=toml, headers=headers)

    def submit(self, method: str) -> str:
        """Submit one more file, and return the id of its submission."""
        answer = self._clients["team"].post(
            "/submissions",
            data={"phase": PHASE, "method": method},
            files={"file": ("planner.json.gz", next(self._files))},
        )
        answer.raise_for_status()
        self.n_submitted += 1
        return str(answer.json()["id"])

    def board(self) -> bytes:
        """Return the bytes of the public board."""
        answer = self._clients["team"].get("/leaderboard", params={"phase": PHASE})
        return answer.raise_for_status().content if answer.status_code != 404 else b'{"entries":[]}'

    def n_entries(self) -> int:
        """Return how many submissions stand on the public board."""
        return sum(row["submission_id"] is not None for row in json.loads(self.board())["entries"])

    def close(self) -> None:
        """Close all connections."""
        for client in self._clients.values():
            client.close()


def short_digest(body: bytes) -> str:
    """Return the first digits of the digest of a board."""
    return hashlib.sha256(body).hexdigest()[:12]


_POLL_EVERY_S = 0.05


@dataclass
class Reader:
    """Reads without pause; every body must be one whole recorded board."""

    url: str
    digests: set[str] = field(default_factory=set)
    n_read: int = 0
    torn: list[str] = field(default_factory=list)
    _stop: threading.Event = field(default_factory=threading.Event)

    def __enter__(self) -> Self:
        self._thread = threading.Thread(target=self._read)
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stop.set()
        self._thread.join()

    def _read(self) -> None:
        with httpx.Client(timeout=30) as client:
            while not self._stop.is_set():
                answer = client.get(f"{self.url}/api/v1/leaderboard", params={"phase": PHASE})
                digest = hashlib.sha256(answer.content).hexdigest()
                if answer.status_code != 200 or digest not in answer.headers["etag"]:
                    self.torn.append(f"{answer.status_code} {answer.headers.get('etag')}")
                self.digests.add(digest)
                self.n_read += 1
                time.sleep(_POLL_EVERY_S)
