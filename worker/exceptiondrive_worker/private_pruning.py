"""Pruning the private store: what was not used for long goes first, and nothing is lost by it.

Every file there can be made again from the uploads and the splits, so a prune may run beside any
job, in several processes at once: who misses a file makes it anew.
"""

import shutil
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import structlog

from exceptiondrive_worker.private_store import STALE_AFTER_S, TEMPORARY_PREFIX, PrivateStore, Shelf

VERIFY_PREFIX = "verify-"
_DAY_S = 86_400.0
_log = structlog.get_logger("exceptiondrive.worker")


@dataclass(frozen=True)
class KeptFile:
    """One file of the store."""

    path: Path
    size_bytes: int
    used_at: float
    """Seconds since 1970, to a day: when it was last written or read."""


def files_to_prune(
    files: Iterable[KeptFile], max_bytes: int, unused_since: float
) -> list[KeptFile]:
    """Return the files to remove: those not used since then, and the least used beyond the room."""
    doomed, room = [], max_bytes
    for file in sorted(files, key=lambda kept: kept.used_at, reverse=True):
        room -= file.size_bytes
        if room < 0 or file.used_at < unused_since:
            doomed.append(file)
    return doomed


def prune(store: PrivateStore, *, max_bytes: int, max_age_days: float) -> int:
    """Remove what is too old or too much, and what killed processes left; return how many files."""
    store.sweep()
    _sweep_verifications(store.root)
    unused_since = time.time() - max_age_days * _DAY_S
    doomed = files_to_prune(_kept_files(store.root), max_bytes, unused_since)
    for file in doomed:
        file.path.unlink(missing_ok=True)
    if doomed:
        freed = sum(file.size_bytes for file in doomed)
        _log.info("private store pruned", files=len(doomed), bytes=freed)
    return len(doomed)


def _kept_files(root: Path) -> Iterable[KeptFile]:
    for shelf in Shelf:
        for path in (root / shelf).iterdir():
            try:
                status = path.stat()
            except FileNotFoundError:  # another process was quicker
                continue
            if not path.name.startswith(TEMPORARY_PREFIX):
                yield KeptFile(path, status.st_size, status.st_mtime)


def _sweep_verifications(root: Path) -> None:
    for folder in root.glob(f"{VERIFY_PREFIX}*"):
        try:
            is_stale = time.time() - folder.stat().st_mtime > STALE_AFTER_S
        except FileNotFoundError:
            continue
        if is_stale:
            shutil.rmtree(folder, ignore_errors=True)
