"""Memory of a process: a ceiling, so that an upload never ends a machine; and none handed back."""

import resource
from pathlib import Path

import numpy as np

KEEP_BYTES = 24 * 2**20
_STATM = Path("/proc/self/statm")


def address_space_bytes() -> int | None:
    """Return how much address space this process has now; None where the system does not say."""
    try:
        pages = int(_STATM.read_text().split()[0])
    except (FileNotFoundError, PermissionError):
        return None
    return pages * resource.getpagesize()


def keep_memory() -> None:
    """Free one large block that nobody has touched: scoring then takes up to half the time.

    glibc hands freed memory back to the system above a threshold, and pays for every page again at
    the next temporary; the threshold follows the largest block that was freed.
    """
    np.empty(KEEP_BYTES, dtype=np.uint8)


def limit_memory(headroom_bytes: int) -> int | None:
    """Let this process take at most so much beyond what it has; return the limit in bytes.

    Allocations beyond it raise `MemoryError`. Without `/proc` nothing is limited: None.
    """
    present = address_space_bytes()
    if present is None:
        return None
    limit = present + headroom_bytes
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    if hard != resource.RLIM_INFINITY:
        limit = min(limit, hard)
    resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
    return limit
