"""Spread requests evenly over time."""


class Pace:
    """Hands out time slots that lie at least 60 s / `requests_per_minute` apart."""

    def __init__(self, requests_per_minute: float | None) -> None:
        self._interval_s = 60.0 / requests_per_minute if requests_per_minute else 0.0
        self._next_s = float("-inf")

    def reserve(self, now_s: float) -> float:
        """Take the next free slot and return how many seconds away it is.

        Args:
            now_s: Time of any clock that never goes back.
        """
        slot_s = max(now_s, self._next_s)
        self._next_s = slot_s + self._interval_s
        return slot_s - now_s
