"""Public pages that are kept, each until what it was made of is another.

A page follows from a value, which the records tell. While nothing at all was written to the records,
the value is the same; else it is read again, and the page is made again only if it differs. So a page
is never older than the records, whichever process wrote them, and what turns by the clock alone (a
deadline) is seen within `CLOCK_S`.
"""

import gzip
import hashlib
import time
from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace

from exceptiondrive_records.db.memory import Memory

ROOM_BYTES = 24 * 2**20
CLOCK_S = 1.0


@dataclass(frozen=True)
class KeptPage:
    """A page, the value that it was made of, and when that was last read."""

    made_of: object
    state: str
    read_at_s: float
    html: bytes
    gzipped: bytes
    etag: str


class KeptPages:
    """The pages that were asked for last, by address and looks."""

    def __init__(self, room_bytes: int = ROOM_BYTES) -> None:
        self._pages: Memory[Hashable, KeptPage] = Memory(room_bytes)

    @property
    def weight_bytes(self) -> int:
        """How much is kept."""
        return self._pages.weight

    def unchanged(self, site: Hashable, state: str) -> KeptPage | None:
        """Return a page that needs no look at the records: they are in the state they were in."""
        kept = self._pages.get(site)
        if kept is None or kept.state != state or time.monotonic() > kept.read_at_s + CLOCK_S:
            return None
        return kept

    def made(
        self, site: Hashable, state: str, made_of: object, make: Callable[[], str]
    ) -> KeptPage:
        """Return the page of a value; it is made unless it was made of the same one before.

        Args:
            site: Address and looks.
            state: Of the records, asked for before the value was read.
            made_of: The value; all that the page shows follows from it and from `site`.
            make: Makes the page.
        """
        now_s, kept = time.monotonic(), self._pages.get(site)
        if kept is not None and kept.made_of == made_of:
            kept = replace(kept, state=state, read_at_s=now_s)
        else:
            html = make().encode()
            packed = gzip.compress(html, 6, mtime=0)
            kept = KeptPage(made_of, state, now_s, html, packed, hashlib.sha256(html).hexdigest())
        return self._pages.keep(site, kept, len(kept.html) + len(kept.gzipped))
