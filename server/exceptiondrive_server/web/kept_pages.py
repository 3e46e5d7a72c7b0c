"""Cache of public pages: each is rendered about once a second, however many request it.

A page is cached for `MAX_AGE_S`. A change, of this process or another or by the clock alone (a
deadline), shows when it is rendered next.
"""

import gzip
import hashlib
import threading
import time
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from weakref import WeakValueDictionary

from exceptiondrive_records.db.memory import Memory

ROOM_BYTES = 24 * 2**20
MAX_AGE_S = 1.0


@dataclass(frozen=True)
class KeptPage:
    """A page, and when it was made."""

    made_at_s: float
    html: bytes
    gzipped: bytes
    etag: str


class KeptPages:
    """Recently requested pages, by the parts of a request that they depend on."""

    def __init__(self, room_bytes: int = ROOM_BYTES) -> None:
        self._pages: Memory[Hashable, KeptPage] = Memory(room_bytes)
        self._lock = threading.Lock()
        self._makings: WeakValueDictionary[Hashable, threading.Lock] = WeakValueDictionary()

    @property
    def weight_bytes(self) -> int:
        """How much is kept."""
        return self._pages.weight

    def current(self, key: Hashable, make: Callable[[], str]) -> KeptPage:
        """Return a page that is younger than `MAX_AGE_S`, be it made for this.

        Args:
            key: What of a request the page depends on, its address among it.
            make: Reads the records and fills the page.
        """
        return self._fresh_page(key) or self._made_alone(key, make)

    def _fresh_page(self, key: Hashable) -> KeptPage | None:
        kept, now_s = self._pages.get(key), time.monotonic()
        return kept if kept is not None and now_s < kept.made_at_s + MAX_AGE_S else None

    def _made_alone(self, key: Hashable, make: Callable[[], str]) -> KeptPage:
        """One at a time of each address: those who waited find the page that the first one made."""
        with self._lock:
            one_at_a_time = self._makings.setdefault(key, threading.Lock())
        with one_at_a_time:
            kept = self._fresh_page(key)
            if kept is not None:
                return kept
            html = make().encode()
            packed, etag = gzip.compress(html, mtime=0), hashlib.sha256(html).hexdigest()
            kept = KeptPage(time.monotonic(), html, packed, etag)
            return self._pages.keep(key, kept, len(html) + len(packed))
