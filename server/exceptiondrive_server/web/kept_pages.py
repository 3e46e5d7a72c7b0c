"""Public pages that are kept, each until what it was made of is another.

A page follows from a value, which the records tell. While nothing at all was written to the records,
the value is the same; else it is read again, and the page is made again only if it differs. So a page
is never older than the records, whichever process wrote them, and what turns by the clock alone (a
deadline) is seen within `MAX_AGE_S`.
"""

import gzip
import hashlib
import threading
import time
from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace
from weakref import WeakValueDictionary

from exceptiondrive_records.db.memory import Memory

Made = tuple[object, Callable[[], str]]
ROOM_BYTES = 24 * 2**20
MAX_AGE_S = 1.0
"""How long ago the value of a page may have been read, though nothing was written since."""


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
    """The pages that were asked for last, by what of a request they depend on."""

    def __init__(self, room_bytes: int = ROOM_BYTES) -> None:
        self._pages: Memory[Hashable, KeptPage] = Memory(room_bytes)
        self._lock = threading.Lock()
        self._reads: WeakValueDictionary[Hashable, threading.Lock] = WeakValueDictionary()

    @property
    def weight_bytes(self) -> int:
        """How much is kept."""
        return self._pages.weight

    def current(
        self, key: Hashable, state: Callable[[], str], read: Callable[[], Made]
    ) -> KeptPage:
        """Return the page as the records have it now.

        Args:
            key: What of a request the page depends on, its address among it.
            state: Tells the state of the records, before they are read.
            read: Reads what the page follows from, by which it is compared, and what makes it.
        """
        return self._unchanged(key, state()) or self._read_again(key, state, read)

    def _unchanged(self, key: Hashable, state: str) -> KeptPage | None:
        kept = self._pages.get(key)
        if kept is None or kept.state != state or time.monotonic() > kept.read_at_s + MAX_AGE_S:
            return None
        return kept

    def _read_again(
        self, key: Hashable, state: Callable[[], str], read: Callable[[], Made]
    ) -> KeptPage:
        """One at a time of each address: those who waited find the page that the first one read."""
        with self._lock:
            one_at_a_time = self._reads.setdefault(key, threading.Lock())
        with one_at_a_time:
            now, now_s = state(), time.monotonic()
            kept = self._unchanged(key, now)
            if kept is not None:
                return kept
            made_of, make = read()
            kept = self._pages.get(key)
            if kept is not None and kept.made_of == made_of:
                kept = replace(kept, state=now, read_at_s=now_s)
            else:
                html = make().encode()
                packed = gzip.compress(html, mtime=0)
                etag = hashlib.sha256(html).hexdigest()
                kept = KeptPage(made_of, now, now_s, html, packed, etag)
            return self._pages.keep(key, kept, len(kept.html) + len(kept.gzipped))
