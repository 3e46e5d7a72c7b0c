"""Who holds which card: claims for a time, in the records' database.

A browser renews its leases while it is open. One that dies stops; when the time is over, its cards
go to whoever asks next.
"""

from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from time import time
from typing import NamedTuple

from exceptiondrive_build.database import Database

_TABLE = """
CREATE TABLE IF NOT EXISTS leases (
  queue TEXT NOT NULL,
  candidate TEXT NOT NULL,
  browser TEXT NOT NULL,
  reviewer TEXT NOT NULL,
  until REAL NOT NULL,
  PRIMARY KEY (queue, candidate, browser)
) STRICT
"""


class Holder(NamedTuple):
    """A browser, and who is signed in with it."""

    browser: str
    reviewer: str


class Leases(Database):
    """The table."""

    tables = _TABLE

    def __init__(self, path: Path, lease_s: float) -> None:
        """Open it in the records' file; a card is held for `lease_s` without a sign of its browser.

        Raises:
            BuildError: The file cannot be written.
        """
        super().__init__(path)
        self.lease_s = lease_s

    def claim(
        self,
        queue: str,
        holder: Holder,
        count: int,
        offered: Callable[[dict[str, list[Holder]]], Iterator[str]],
    ) -> list[str]:
        """Take cards that nobody holds, and return them.

        `offered` gives cards, the first to take first, from who holds which now.

        Raises:
            BuildError: The file cannot be written.
        """
        now = time()
        taken: list[str] = []
        with self._transaction() as write:
            write.execute("DELETE FROM leases WHERE until <= ?", (now,))
            held = defaultdict(list)
            for candidate, *rest in write.execute(
                "SELECT candidate, browser, reviewer FROM leases WHERE queue = ?", (queue,)
            ):
                held[candidate].append(Holder(*rest))
            for candidate in offered(held):
                if len(taken) == count:
                    break
                write.execute(
                    "INSERT OR REPLACE INTO leases VALUES (?, ?, ?, ?, ?)",
                    (queue, candidate, *holder, now + self.lease_s),
                )
                taken.append(candidate)
        return taken

    def renew(self, holder: Holder) -> None:
        """Hold all cards of a browser for longer; what is over stays over."""
        now = time()
        with self._transaction() as write:
            write.execute(
                "UPDATE leases SET until = ? WHERE browser = ? AND until > ?",
                (now + self.lease_s, holder.browser, now),
            )

    def holds(self, queue: str, candidate: str, holder: Holder) -> bool:
        """Whether a browser holds a card."""
        with self._told():
            found = self._connection.execute(
                "SELECT 1 FROM leases WHERE queue = ? AND candidate = ? AND browser = ? "
                "AND until > ?",
                (queue, candidate, holder.browser, time()),
            ).fetchone()
        return found is not None

    def give_back(self, holder: Holder, queue: str | None = None, candidate: str = "") -> None:
        """Give one card back, or all that a browser holds."""
        with self._transaction() as write:
            if queue is None:
                write.execute("DELETE FROM leases WHERE browser = ?", (holder.browser,))
            else:
                write.execute(
                    "DELETE FROM leases WHERE queue = ? AND candidate = ? AND browser = ?",
                    (queue, candidate, holder.browser),
                )
