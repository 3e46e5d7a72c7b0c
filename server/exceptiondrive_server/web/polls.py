"""Poll submissions for their followers: one query at a time for each, however many follow it."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from fastapi.concurrency import run_in_threadpool

from exceptiondrive_schemas.api.submission import SubmissionView

Followed = tuple[str, int | None]
"""A submission, and the team that is confined to its own; None: an organizer."""


@dataclass
class _Seen:
    view: SubmissionView
    at_s: float
    is_polled: bool = False
    n_followers: int = 0


class Polls:
    """What followers are told; for one thread, the one that runs the event loop.

    Each of them would ask the records in a thread of its own, twice a second: two hundred streams of
    one team made the API of all others wait for half a minute.
    """

    def __init__(self, every_s: float) -> None:
        self._every_s = every_s
        self._seen: dict[Followed, _Seen] = {}

    @contextmanager
    def following(self, followed: Followed, now: SubmissionView) -> Iterator[None]:
        """Know what a follower saw first, as long as somebody follows."""
        seen = self._seen.setdefault(followed, _Seen(now, 0.0))
        seen.view, seen.at_s = now, time.monotonic()
        seen.n_followers += 1
        try:
            yield
        finally:
            seen.n_followers -= 1
            if not seen.n_followers:
                del self._seen[followed]

    async def now(self, followed: Followed, read: Callable[[], SubmissionView]) -> SubmissionView:
        """Return what is followed as somebody saw it just now; else read it."""
        seen = self._seen[followed]
        is_old = time.monotonic() >= seen.at_s + self._every_s
        if is_old and not seen.is_polled:
            seen.is_polled = True
            try:
                seen.view = await run_in_threadpool(read)
                seen.at_s = time.monotonic()
            finally:
                seen.is_polled = False
        return seen.view
