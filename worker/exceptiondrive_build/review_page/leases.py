"""Leases: which browser holds which card, for a limited time, in the records' database.

A browser renews its leases while it is open. If it dies, its leases expire, and its cards go to the
next one that asks.
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
    """A browser, and the person signed in with it."""

    browser: str
    reviewer: str


class Leases(Database):
    """The table of leases."""

    tables = _TABLE

    def __init__(self, path: Path, lease_s: float) -> None:
        """Open the table in the records' file; a lease lasts `lease_s` unless renewed.

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
        """Claim cards that nobody holds, and return them.

        `offered` maps the present holders to cards, in the order in which to claim them.

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
        """Renew all leases of a browser; expired ones stay expired."""
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
        """Release one card, or all that a browser holds."""
        with self._transaction() as write:
            if queue is None:
                write.execute("DELETE FROM leases WHERE browser = ?", (holder.browser,))
            else:
                write.execute(
                    "DELETE FROM leases WHERE queue = ? AND candidate = ? AND browser = ?",
                    (queue, candidate, holder.browser),
                )
