"""What clients did and were told: the only witness beside records and files."""

import threading
import time
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Call:
    """One upload, and what came back; `status` is None when nothing did."""

    team: str
    file_digest: str
    method: str
    started_s: float
    took_s: float
    status: int | None
    submission_id: str | None
    retry_after: str | None = None
    is_busy: bool = False
    """Told that the team sends too much at once, and to come again."""

    @property
    def is_accepted(self) -> bool:
        return self.status in (200, 202)

    @property
    def is_refused(self) -> bool:
        """Told for certain that nothing was taken: a client error, not an outage."""
        return self.status is not None and 400 <= self.status < 500 and not self.is_busy


@dataclass(frozen=True)
class Sighting:
    """A submission's status as its team saw it."""

    at_s: float
    submission_id: str
    status: str
    sheet: dict[str, Any] | None = None
    """The whole score sheet as it was told."""


@dataclass(frozen=True)
class BoardSeen:
    """A board as a reader saw it."""

    at_s: float
    took_s: float
    etag: str
    body: bytes


@dataclass
class History:
    """Everything that clients did, in order of time; any thread may write."""

    calls: list[Call] = field(default_factory=list)
    sightings: list[Sighting] = field(default_factory=list)
    boards: list[BoardSeen] = field(default_factory=list)
    given_up: list[Call] = field(default_factory=list)
    restored: set[str] = field(default_factory=set)
    """Ids of what an organizer gave back after it was withdrawn."""
    """Uploads that were sent again and again, and never got an answer that says what became of them."""
    audit_heads: dict[int, str] = field(default_factory=dict)
    """The last line of the audit chain whenever the checker looked: its number and its hash."""
    unanswered_reads: int = 0
    started_s: float = field(default_factory=time.monotonic)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def so_far(self) -> "History":
        """Return what happened until now, which does not go on."""
        with self._lock:
            return History(
                calls=list(self.calls),
                sightings=list(self.sightings),
                boards=list(self.boards),
                given_up=list(self.given_up),
                restored=set(self.restored),
                audit_heads=dict(self.audit_heads),
            )

    def now_s(self) -> float:
        return time.monotonic() - self.started_s

    def note(self, event: Call | Sighting | BoardSeen) -> None:
        with self._lock:
            match event:
                case Call():
                    self.calls.append(event)
                case Sighting():
                    self.sightings.append(event)
                case BoardSeen():
                    self.boards.append(event)
