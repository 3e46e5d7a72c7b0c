"""The worker's private store: what scoring keeps, under the hash of what made it.

Per-sample columns are withheld: only workers may read this folder (0700).
Nothing here is the truth. Every file can be made again from the uploads and the splits, so a file
that is missing, cut short or damaged is simply absent, and the next run writes it anew.
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
"""No array wants more, and what is read from a file begins at a multiple of it."""
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
    """What no required clearance changes in a sheet. Key: measurement, plausibility, groups."""
    INTERVALS = "intervals"
    """Intervals and draws of one entry. Key: measurement, grading, tasks and scenes of the split, ranking."""
    FINGERPRINTS = "fingerprints"
    """What some samples were answered with. Key: file, and which samples."""
    COMPARISONS = "comparisons"
    """Two entries against each other. Key: as the intervals of both."""


def content_key(*parts: str) -> str:
    """Return the hex key that stands for an ordered list of parts."""
    return hashlib.sha256(json.dumps(parts).encode("utf-8")).hexdigest()


def array_digest(*arrays: NDArray[Any]) -> str:
    """Return the hex digest of arrays: type, shape and every bit."""
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(f"{array.dtype.str}{array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def pack_columns(columns: Columns) -> bytes:
    """Return columns as one byte string: a JSON line of names and types, then the arrays.

    Each array begins where its type may lie in memory: numpy copies what does not, at every step.
    """
    arrays = {name: np.asarray(columns[name], order="C") for name in sorted(columns)}
    arrays = dict(sorted(arrays.items(), key=lambda item: -item[1].dtype.alignment))
    head = json.dumps([[name, array.dtype.str, array.shape] for name, array in arrays.items()])
    blanks = -(len(head) + 1) % _ALIGNED_BYTES
    return b"".join([head.encode(), b" " * blanks, b"\n", *(each.data for each in arrays.values())])


def unpack_columns(data: bytes) -> Columns:
    """Read what `pack_columns` wrote; the arrays are views and cannot be written to."""
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
    """CRC-32, which tells accidents: who may write here could make any other, too. Zeros have none of 0."""
    return zlib_ng.crc32(data, 1).to_bytes(_CHECKSUM_BYTES, "big")


class PrivateStore:
    """Content-keyed files under one folder that nobody but the worker may enter."""

    def __init__(self, root: Path) -> None:
        self.root = root
        for folder in (root, *(root / shelf for shelf in Shelf)):
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            folder.chmod(0o700)

    def read(self, shelf: Shelf, key: str) -> bytes | None:
        """Return the bytes kept under `key`, or None where they are absent, damaged or cannot be read."""
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
        """Keep `data` under `key`.

        It is written in its place: until all of it is there, and where the writer was killed, a reader
        finds it absent. Two that write one key write the same bytes. What cannot be written, on a full
        disk say, is made again when it is asked for: it keeps nothing from being scored.
        """
        try:
            with open(self._path(shelf, key), "wb", opener=_as_owner) as file:
                file.write(_checksum(data))
                file.write(data)
        except OSError as error:
            _log.warning("not kept in the private store", shelf=shelf.value, why=error.strerror)

    def read_columns(self, shelf: Shelf, key: str) -> Columns | None:
        """Return the columns kept under `key`, or None."""
        data = self.read(shelf, key)
        return None if data is None else unpack_columns(data)

    def read_document(self, shelf: Shelf, key: str, kind: type[AnyDocument]) -> AnyDocument | None:
        """Return the document kept under `key`, or None, where another version wrote it, too."""
        data = self.read(shelf, key)
        if data is None:
            return None
        try:
            return kind.model_validate_json(data)
        except ValidationError:
            return None

    def write_columns(self, shelf: Shelf, key: str, columns: Columns) -> None:
        """Keep columns under `key`."""
        self.write(shelf, key, pack_columns(columns))

    def _path(self, shelf: Shelf, key: str) -> str:
        return f"{self.root}/{shelf}/{key}"


def _as_owner(path: str, flags: int) -> int:
    return os.open(path, flags, 0o600)


def _note_use(file: int) -> None:
    """Let the open file's time tell, to a day, when it was last used: pruning begins with the oldest."""
    if time.time() - os.fstat(file).st_mtime > _DAY_S:
        os.utime(file)


def prune(store: PrivateStore, *, max_bytes: int, max_age_days: float) -> int:
    """Remove what was not used for so long, and the least used beyond the room; return how many files.

    What killed verifications left goes, too.
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
    """Yield each file; when it was last written or read its time tells to a day."""
    for shelf in Shelf:
        for path in (root / shelf).iterdir():
            with suppress(FileNotFoundError):  # another process was quicker
                yield path, path.stat()


def _sweep_verifications(root: Path) -> None:
    for folder in root.glob(f"{VERIFY_PREFIX}*"):
        try:
            is_stale = time.time() - folder.stat().st_mtime > STALE_AFTER_S
        except FileNotFoundError:
            continue
        if is_stale:
            shutil.rmtree(folder, ignore_errors=True)
