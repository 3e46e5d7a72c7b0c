"""A ceiling on memory: an upload ends a scoring run, never a machine."""

import resource
from pathlib import Path

_STATM = Path("/proc/self/statm")


def address_space_bytes() -> int | None:
    """Return how much address space this process has now; None where the system does not say."""
    try:
        pages = int(_STATM.read_text().split()[0])
    except (FileNotFoundError, PermissionError):
        return None
    return pages * resource.getpagesize()


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
