"""A reader that looks at the public board all the while."""

import hashlib
import threading
import time
from dataclasses import dataclass, field
from types import TracebackType
from typing import Self

import httpx

from benchmarks.rescore_drill.stage import PHASE

_LOOK_EVERY_S = 0.05


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
                time.sleep(_LOOK_EVERY_S)
