"""Finds the valid id that an invalid one was probably meant to be."""

import difflib
from bisect import bisect
from collections.abc import Iterable

NEIGHBOURS = 25
MAX_ID_CHARACTERS = 128
SIMILARITY = 0.75


class NearestId:
    """Sorted valid ids; a search looks at few of them, so that 50,000 cost no more than 50.

    A mistyped id still shares its beginning or its end with the right one, hence it stands near it
    in the order of the ids, or in the order of the reversed ids.
    """

    def __init__(self, valid_ids: Iterable[str]) -> None:
        self._forward = sorted(valid_ids)
        self._backward = sorted(valid_id[::-1] for valid_id in self._forward)

    def nearest(self, wanted: str) -> str | None:
        """Return the valid id most like `wanted`, or None where none is like it."""
        if len(wanted) > MAX_ID_CHARACTERS:
            return None
        near = _around(self._forward, wanted)
        near += [valid_id[::-1] for valid_id in _around(self._backward, wanted[::-1])]
        found = difflib.get_close_matches(wanted, near, n=1, cutoff=SIMILARITY)
        return found[0] if found else None


def _around(ordered: list[str], wanted: str) -> list[str]:
    at = bisect(ordered, wanted)
    return ordered[max(at - NEIGHBOURS, 0) : at + NEIGHBOURS]
