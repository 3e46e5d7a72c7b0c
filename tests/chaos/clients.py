"""Participants and readers: real HTTP, retries as the client's, everything noted."""

import random
import threading
import time
from collections.abc import Mapping, Sequence
from typing import Any

import httpx
from tests.chaos.history import BoardSeen, Call, History, Sighting
from tests.chaos.splits import Drive
from tests.chaos.topology import PHASE, TEAMS, Topology
from tests.support import documents
from tests.support.documents import digest_of

from exceptiondrive_schemas.api.problems import ProblemCode

_TIMEOUT_S = 20.0
_PAUSE_S = 0.5
_GIVE_UP_AFTER_S = 90.0


def planning_file(
    sample_ids: Sequence[str], speed_mps: float, drives: Mapping[str, Drive] | None = None
) -> bytes:
    """Everybody drives straight ahead; the speed makes the file its own.

    Args:
        sample_ids: What is answered.
        speed_mps: In every edited scene.
        drives: The source of each sample, as it was recorded there: a source that fits no record is
            looked at three times as long.
    """
    return documents.planning_file(
        dict.fromkeys(sample_ids, speed_mps),
        source_mps=5.0,
        split="sample",
        changes={key: {"source": drive} for key, drive in (drives or {}).items()},
    )


class Clients:
    """A stream of uploads, and readers that look at submissions and board all the while."""

    def __init__(
        self, topology: Topology, history: History, *, looks_a_second: int, seed: int = 1
    ) -> None:
        self.topology = topology
        self.history = history
        self._random = random.Random(seed)
        self._between_looks_s = 1 / looks_a_second
        self._http = httpx.Client(base_url=f"{topology.url}/api/v1", timeout=_TIMEOUT_S)
        self._number = 0
        self._streams: list[threading.Thread] = []
        self._last_board: tuple[str, bytes] | None = None
        self._seen: dict[str, tuple[str, dict[str, Any] | None]] = {}
        self._stopped = threading.Event()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def new_file(self) -> bytes:
        self._number += 1
        speed_mps = round(1 + self._number * 0.01 + self._random.random() / 1000, 6)
        return planning_file(self.topology.sample_ids, speed_mps, self.topology.drives)

    def stream(self, n: int, every_s: float = 0.15) -> None:
        """Submit `n` files of all teams in turn, in the background."""
        thread = threading.Thread(target=self._stream, args=(n, every_s))
        self._streams.append(thread)
        thread.start()

    def join(self) -> None:
        """Wait until every stream has had an answer to everything."""
        for thread in self._streams:
            thread.join()
        self._streams.clear()

    def is_streaming(self) -> bool:
        return any(thread.is_alive() for thread in self._streams)

    def submit(self, data: bytes, team: str, *, patient: bool = True) -> Call:
        """Upload as the client does: what was not answered, or with 5xx, is sent again."""
        started = time.monotonic()
        while True:
            call = self._post(data, team)
            self.history.note(call)
            if call.is_accepted or call.is_refused or not patient:
                return call
            if time.monotonic() > started + _GIVE_UP_AFTER_S:
                self.history.given_up.append(call)
                return call
            time.sleep(_PAUSE_S)

    def withdraw(self, call: Call, token: str | None = None) -> int:
        """Take a submission back, as its team or with a token; return the status of the answer."""
        path = f"/submissions/{call.submission_id}/withdraw"
        headers = {"Authorization": f"Bearer {token}"} if token else self._headers(call.team)
        return self._http.post(path, headers=headers).status_code

    def restore(self, call: Call, token: str) -> int:
        """Give a withdrawn submission back, as an organizer; return the status of the answer."""
        self.history.restored.add(call.submission_id or "")
        path = f"/organizer/submissions/{call.submission_id}/restore"
        headers = {"Authorization": f"Bearer {token}"}
        return self._http.post(path, json={"reason": "a mistake"}, headers=headers).status_code

    def show(self, call: Call, what: str = "") -> dict[str, Any]:
        """Ask as its team for a submission, or for a part such as `/receipt`."""
        answer = self._http.get(
            f"/submissions/{call.submission_id}{what}", headers=self._headers(call.team)
        )
        answer.raise_for_status()
        shown: dict[str, Any] = answer.json()
        return shown

    def receipt_keys(self) -> dict[str, Any]:
        """Ask for the public keys of receipts, as anybody may."""
        keys: dict[str, Any] = self._http.get("/receipt-keys").raise_for_status().json()
        return keys

    def close(self) -> None:
        self.join()
        self._stopped.set()
        self._reader.join()
        self._http.close()

    def _stream(self, n: int, every_s: float) -> None:
        for index in range(n):
            self.submit(self.new_file(), TEAMS[index % len(TEAMS)])
            time.sleep(every_s)

    def _post(self, data: bytes, team: str) -> Call:
        began_s, digest = self.history.now_s(), digest_of(data)
        method = f"m{int(digest[-6:], 16) % 3}"
        status, submission_id, wait, is_busy = None, None, None, False
        try:
            answer = self._http.post(
                "/submissions",
                data={"phase": PHASE, "method": method},
                files={"file": ("f.json", data)},
                headers=self._headers(team),
            )
            status, wait = answer.status_code, answer.headers.get("Retry-After")
            if status in (200, 202):
                submission_id = answer.json()["id"]
            elif status == 429:
                is_busy = answer.json()["code"] == ProblemCode.TOO_MANY_REQUESTS
        except httpx.HTTPError:
            pass
        took_s = self.history.now_s() - began_s
        return Call(team, digest, method, began_s, took_s, status, submission_id, wait, is_busy)

    def _headers(self, team: str) -> dict[str, str]:
        return {"Authorization": f"Bearer {self.topology.tokens[team]}"}

    def _read(self) -> None:
        """Look at every team's submissions and at the board, in turn, until closed."""
        with httpx.Client(base_url=f"{self.topology.url}/api/v1", timeout=_TIMEOUT_S) as http:
            turn = 0
            while not self._stopped.wait(self._between_looks_s):
                turn += 1
                try:
                    self._look_at_board(http)
                    self._look_at_submissions(http, TEAMS[turn % len(TEAMS)])
                except httpx.HTTPError:
                    self.history.unanswered_reads += 1

    def _look_at_board(self, http: httpx.Client) -> None:
        began_s = self.history.now_s()
        answer = http.get("/leaderboard", params={"phase": PHASE})
        took_s = self.history.now_s() - began_s
        if answer.status_code == 200:
            seen = BoardSeen(began_s, took_s, answer.headers["ETag"], answer.content)
            if (seen.etag, seen.body) != self._last_board:
                self._last_board = seen.etag, seen.body
                self.history.note(seen)

    def _look_at_submissions(self, http: httpx.Client, team: str) -> None:
        at_s = self.history.now_s()
        answer = http.get("/submissions", params={"limit": 200}, headers=self._headers(team))
        if answer.status_code != 200:
            return
        for row in answer.json()["submissions"]:
            told = row["status"], row.get("sheet")
            if self._seen.get(row["id"]) != told:
                self._seen[row["id"]] = told
                self.history.note(Sighting(at_s, row["id"], *told))
