"""The worker's private store: a cache of scoring results, keyed by the hash of their inputs.

Per-sample columns are withheld: only workers may read this folder (0700).
Nothing here is authoritative. Every file can be recomputed from the uploads and the splits, so a
missing, truncated or damaged file counts as a cache miss, and the next run writes it again.
"""

import hashlib
import json
import math
import os
import shutil
import time
from collections.abc import Iterator
from contextlib import suppress
from enum import StrEnum
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import structlog
from numpy.typing import NDArray
from pydantic import ValidationError
from zlib_ng import zlib_ng

from exceptiondrive_schemas.base import Document
from exceptiondrive_scoring.aliases import Columns

AnyDocument = TypeVar("AnyDocument", bound=Document)

_CHECKSUM_BYTES = 4
_ALIGNED_BYTES = 16
"""No array needs a larger alignment, and file contents start at a multiple of it."""
STALE_AFTER_S = 3600
VERIFY_PREFIX = "verify-"
_DAY_S = 86_400.0
_log = structlog.get_logger("exceptiondrive.worker")


class Shelf(StrEnum):
    """One folder of the store."""

    ANSWERS = "answers"
    """What was submitted, as columns in the split's order. Key: upload, sample ids, waypoints."""
    MEASUREMENTS = "measurements"
    """Per sample: clearance, intrusion, shifts. Key: as the answers, and regions, geometry."""
    SETTLED = "settled"
    """The part of a sheet without required clearances. Key: measurement, plausibility, groups."""
    INTERVALS = "intervals"
    """Intervals and draws of one entry. Key: measurement, grading, tasks and scenes of the split, ranking."""
    FINGERPRINTS = "fingerprints"
    """The answers to some samples. Key: file, and which samples."""
    COMPARISONS = "comparisons"
    """Paired comparisons of two entries. Key: as the intervals of both."""


def content_key(*parts: str) -> str:
    """Return the hex key of an ordered list of parts."""
    return hashlib.sha256(json.dumps(parts).encode("utf-8")).hexdigest()


def array_digest(*arrays: NDArray[Any]) -> str:
    """Return the hex digest of arrays: of type, shape and every bit."""
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(f"{array.dtype.str}{array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def pack_columns(columns: Columns) -> bytes:
    """Return columns as one byte string: a JSON line of names and types, then the arrays.

    Each array is aligned for its type: numpy copies unaligned arrays at every step.
    """
    arrays = {name: np.asarray(columns[name], order="C") for name in sorted(columns)}
    arrays = dict(sorted(arrays.items(), key=lambda item: -item[1].dtype.alignment))
    head = json.dumps([[name, array.dtype.str, array.shape] for name, array in arrays.items()])
    blanks = -(len(head) + 1) % _ALIGNED_BYTES
    return b"".join([head.encode(), b" " * blanks, b"\n", *(each.data for each in arrays.values())])


def unpack_columns(data: bytes) -> Columns:
    """Read what `pack_columns` wrote; the arrays are read-only views."""
    end_of_head = data.index(b"\n")
    columns: dict[str, NDArray[Any]] = {}
    start = end_of_head + 1
    for name, type_text, shape in json.loads(data[:end_of_head]):
        dtype = np.dtype(type_text)
        count = math.prod(shape)
        columns[name] = np.frombuffer(data, dtype, count, start).reshape(shape)
        start += count * dtype.itemsize
    return columns


def _checksum(data: bytes) -> bytes:
    """Return CRC-32, which detects accidents, not tampering; that of zeros is not 0."""
    return zlib_ng.crc32(data, 1).to_bytes(_CHECKSUM_BYTES, "big")


class PrivateStore:
    """Content-addressed files under one folder that only the worker may enter."""

    def __init__(self, root: Path) -> None:
        self.root = root
        for folder in (root, *(root / shelf for shelf in Shelf)):
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            folder.chmod(0o700)

    def read(self, shelf: Shelf, key: str) -> bytes | None:
        """Return the bytes stored under `key`; None if they are missing, damaged or unreadable."""
        try:
            with open(self._path(shelf, key), "rb", buffering=0) as file:
                framed = file.read()
                _note_use(file.fileno())
        except FileNotFoundError:
            return None
        except OSError as error:
            _log.warning("not read from the private store", shelf=shelf.value, why=error.strerror)
            return None
        checksum, data = framed[:_CHECKSUM_BYTES], framed[_CHECKSUM_BYTES:]
        return data if _checksum(data) == checksum else None

    def write(self, shelf: Shelf, key: str, data: bytes) -> None:
        """Store `data` under `key`.

        It is written in place: until it is complete, or if the writer was killed, readers see a
        miss. Concurrent writers of one key write the same bytes. Failed writes, on a full disk for
        example, are ignored: the data are recomputed when needed, and scoring goes on.
        """
        try:
            with open(self._path(shelf, key), "wb", opener=_as_owner) as file:
                file.write(_checksum(data))
                file.write(data)
        except OSError as error:
            _log.warning("not kept in the private store", shelf=shelf.value, why=error.strerror)

    def read_columns(self, shelf: Shelf, key: str) -> Columns | None:
        """Return the columns stored under `key`, or None."""
        data = self.read(shelf, key)
        return None if data is None else unpack_columns(data)

    def read_document(self, shelf: Shelf, key: str, kind: type[AnyDocument]) -> AnyDocument | None:
        """Return the document stored under `key`; None also if another version wrote it."""
        data = self.read(shelf, key)
        if data is None:
            return None
        try:
            return kind.model_validate_json(data)
        except ValidationError:
            return None

    def write_columns(self, shelf: Shelf, key: str, columns: Columns) -> None:
        """Store columns under `key`."""
        self.write(shelf, key, pack_columns(columns))

    def _path(self, shelf: Shelf, key: str) -> str:
        return f"{self.root}/{shelf}/{key}"


def _as_owner(path: str, flags: int) -> int:
    return os.open(path, flags, 0o600)


def _note_use(file: int) -> None:
    """Set the open file's time to its last use, to a day: pruning removes the oldest first."""
    if time.time() - os.fstat(file).st_mtime > _DAY_S:
        os.utime(file)


def prune(store: PrivateStore, *, max_bytes: int, max_age_days: float) -> int:
    """Remove files not used for `max_age_days`, and the least recently used beyond `max_bytes`.

    Returns their number. Remains of killed verifications are removed, too.
    """
    _sweep_verifications(store.root)
    unused_since, room = time.time() - max_age_days * _DAY_S, max_bytes
    n_files = n_bytes = 0
    for path, status in sorted(
        _kept_files(store.root), key=lambda kept: kept[1].st_mtime, reverse=True
    ):
        room -= status.st_size
        if room < 0 or status.st_mtime < unused_since:
            path.unlink(missing_ok=True)
            n_files, n_bytes = n_files + 1, n_bytes + status.st_size
    if n_files:
        _log.info("private store pruned", files=n_files, bytes=n_bytes)
    return n_files


def _kept_files(root: Path) -> Iterator[tuple[Path, os.stat_result]]:
    """Yield each file; its time is its last use, to a day."""
    for shelf in Shelf:
        for path in (root / shelf).iterdir():
            with suppress(FileNotFoundError):  # another process removed it first
                yield path, path.stat()


def _sweep_verifications(root: Path) -> None:
    for folder in root.glob(f"{VERIFY_PREFIX}*"):
        try:
            is_stale = time.time() - folder.stat().st_mtime > STALE_AFTER_S
        except FileNotFoundError:
            continue
        if is_stale:
            shutil.rmtree(folder, ignore_errors=True)
