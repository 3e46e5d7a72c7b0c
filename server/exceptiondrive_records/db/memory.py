"""A least-recently-used cache, bounded by bytes, of values that are expensive to compute."""

import threading
from collections import OrderedDict
from collections.abc import Hashable
from typing import Generic, TypeVar

K = TypeVar("K", bound=Hashable)
V = TypeVar("V")


class Memory(Generic[K, V]):
    """Values by key, bounded by their total weight. Safe to share between threads.

    The newest value is kept even beyond the bound: otherwise every request would compute it again.
    """

    def __init__(self, room: int) -> None:
        self._room = room
        self._kept: OrderedDict[K, tuple[V, int]] = OrderedDict()
        self._lock = threading.Lock()
        self.weight = 0
        """Total weight of the cached values."""

    def get(self, key: K) -> V | None:
        """Return the value of a key, if cached."""
        with self._lock:
            if key not in self._kept:
                return None
            self._kept.move_to_end(key)
            return self._kept[key][0]

    def keep(self, key: K, value: V, weight: int) -> V:
        """Store a value under its key, replacing any earlier one, and return it."""
        with self._lock:
            self.weight -= self._kept.pop(key, (None, 0))[1]
            self._forget_beyond(self._room - weight)
            self._kept[key] = value, weight
            self.weight += weight
        return value

    def make_room(self, weight: int) -> None:
        """Evict values until one of this weight fits, before it is computed."""
        with self._lock:
            self._forget_beyond(self._room - weight)

    def _forget_beyond(self, weight: int) -> None:
        while self._kept and self.weight > weight:
            self.weight -= self._kept.popitem(last=False)[1][1]
