"""The split store: the only access to withheld splits.

A split is in `<folder>/<name>/split.json` or `split.json.gz`. Older revisions may stay beside it
(`split-2026.json.gz`), so that entries scored against them can be scored again. A split whose
samples name parts is three revisions: the whole, and each part by the digest of its own samples.
Nothing read here leaves the worker: the manifest carries sample ids only.
"""

import gzip
import json
import os
import time
import zlib
from collections import Counter
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from exceptiondrive_schemas.api.phase_settings import SplitPart
from exceptiondrive_schemas.base import content_digest, fault_words
from exceptiondrive_schemas.check.inflate import GZIP_MAGIC
from exceptiondrive_schemas.datasheet import Datasheet
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.split import Manifest, Split
from exceptiondrive_scoring.aliases import FloatArray, IntArray
from exceptiondrive_scoring.arrays import SplitArrays, recorded_m, split_arrays
from exceptiondrive_worker.splits.faults import SplitRefusedError, split_faults
from exceptiondrive_worker.splits.floors import FloorsUnreadableError, SplitFloors, read_floors
from exceptiondrive_worker.splits.private_store import array_digest

MAX_SPLIT_BYTES = 256 * 2**20
NOT_FOUND_FOR_S = 60.0
FileState = tuple[int, int]
"""Size and modification time of a file."""


class SplitUnavailableError(LookupError):
    """No file holds the registered revision of a split: nothing may be scored against it."""


class SplitUnreadableError(ValueError):
    """The file is not a split."""


@dataclass(frozen=True)
class LoadedSplit:
    """A split under one protocol: its public manifest and its withheld arrays.

    Attributes:
        manifest: The public part: all sample ids that a file answers, in canonical order. Of a part
            it names the samples of the whole, under the revision of the part.
        arrays: Regions, tasks and scenes of the samples that count, in the same order.
        samples_digest: Digest of the manifest's ids in this order: the key for reading an upload.
        regions_digest: Digest of what `measure` reads.
        grading_digest: Digest of what `grade` reads: tasks, families, d_safe, acceptable; and which
            samples are controls.
        scenes_digest: Digest of what the bootstrap reads in addition.
        rows: (N,) positions of the samples that count among the manifest's; None: all count.
        control_rows: Positions of the controls; empty without any.
        recorded_m: (M, T, 2) recorded paths of all samples that a file answers; None without any.
    """

    manifest: Manifest
    arrays: SplitArrays
    samples_digest: str
    regions_digest: str
    grading_digest: str
    scenes_digest: str
    rows: IntArray | None = None
    control_rows: IntArray = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    recorded_m: FloatArray | None = None

    @property
    def counted_ids(self) -> tuple[str, ...]:
        """Ids of the samples of `arrays`, in the same order."""
        ids = self.manifest.sample_ids
        return tuple(ids) if self.rows is None else tuple(ids[row] for row in self.rows.tolist())

    @cached_property
    def groups_digest(self) -> str:
        """Digest of the groups over which samples are summed, and of the set of controls."""
        groups = (self.arrays.task_index, self.arrays.family_index)
        return array_digest(*groups, self.control_rows)

    @cached_property
    def rows_digest(self) -> str | None:
        """Digest of the set of samples that count; None if all do."""
        return None if self.rows is None else array_digest(self.rows)


def read_split(path: Path) -> Split:
    """Read a split file, gzipped or not.

    Raises:
        SplitUnreadableError: Not a split; every problem is listed, none with a withheld value.
    """
    try:
        data = path.read_bytes()
        if data.startswith(GZIP_MAGIC):
            with gzip.open(path) as file:
                data = file.read(MAX_SPLIT_BYTES + 1)
    except (gzip.BadGzipFile, zlib.error, EOFError):
        raise SplitUnreadableError(
            f"{path.name} is damaged or cut short: put back a whole copy of it"
        ) from None
    except OSError as error:
        why = error.strerror or type(error).__name__
        raise SplitUnreadableError(f"{path.name} cannot be read: {why}") from None
    if len(data) > MAX_SPLIT_BYTES:
        raise SplitUnreadableError(f"{path.name} is larger than {MAX_SPLIT_BYTES} bytes")
    try:
        return Split.model_validate_json(data)
    except ValidationError as error:
        lines = "\n".join(_problems(error, data))
        raise SplitUnreadableError(f"{path.name} is not a split:\n{lines}") from None


def datasheet_beside(split_path: Path) -> Path:
    """Return the path of the datasheet of a split file, whether or not it exists."""
    name = split_path.name.split(".json")[0].replace("split", "datasheet", 1)
    return split_path.with_name(f"{name}.json")


def read_datasheet(split_path: Path) -> Datasheet | None:
    """Return the datasheet beside a split file, if there is one.

    `split.json.gz` has `datasheet.json`, and `split-2026.json.gz` has `datasheet-2026.json`.

    Raises:
        SplitUnreadableError: The file is no datasheet.
    """
    path = datasheet_beside(split_path)
    if not path.exists():
        return None
    try:
        return Datasheet.model_validate_json(path.read_bytes())
    except (OSError, ValidationError) as error:
        raise SplitUnreadableError(
            f"{path.name} is no datasheet ({type(error).__name__})"
        ) from None


def _problems(error: ValidationError, data: bytes) -> list[str]:
    """Return one line per problem, with the sample's id in place of its index if it has one."""
    items = error.errors(include_url=False, include_input=False, include_context=False)
    if items[0]["type"] == "json_invalid":
        return ["not JSON"]
    document = json.loads(data)
    places = (_place(item["loc"], document) or "file" for item in items)
    return [f"{at}: {fault_words(item['msg'])}" for at, item in zip(places, items, strict=True)]


def _place(location: tuple[int | str, ...], document: Any) -> str:
    parts = [str(part) for part in location]
    match location:
        case ("samples", int(index), _, *_):
            sample = document["samples"][index]
            if isinstance(sample, dict) and isinstance(sample.get("sample_id"), str):
                parts[:2] = [f"sample {sample['sample_id']}"]
    return ".".join(parts)


def load_split(
    split: Split, protocol: ProtocolDocument, part: SplitPart | None = None
) -> LoadedSplit:
    """Return manifest and arrays of a split or a part of it, in the canonical order of sample ids.

    Raises:
        SplitRefusedError: A sample cannot be scored under this protocol; all are listed.
    """
    faults = split_faults(split, protocol)
    if faults:
        raise SplitRefusedError(split.name, faults)
    samples = sorted(split.samples, key=lambda sample: sample.sample_id)
    chosen = [i for i, sample in enumerate(samples) if part is None or sample.part == part]
    rows = [i for i in chosen if samples[i].counts]
    control_ids = {sample.sample_id for sample in split.controls}
    controls = [i for i in chosen if samples[i].sample_id in control_ids]
    control_rows = np.array(controls, dtype=np.int64)
    arrays = split_arrays([samples[i] for i in rows], protocol.taxonomy)
    recorded = [] if arrays.recorded_m is None else [arrays.recorded_m]
    return LoadedSplit(
        manifest=Manifest.of(split, protocol.geometry, split.part(part).revision),
        arrays=arrays,
        samples_digest=content_digest([sample.sample_id for sample in samples]),
        regions_digest=array_digest(arrays.regions_m, *recorded),
        grading_digest=array_digest(
            arrays.task_index,
            arrays.family_index,
            arrays.d_safe_m,
            arrays.acceptable,
            *([control_rows] if controls else []),
        ),
        scenes_digest=array_digest(arrays.scene_index),
        rows=None if len(rows) == len(samples) else np.array(rows, dtype=np.int64),
        control_rows=control_rows,
        recorded_m=recorded_m([sample.recorded for sample in samples]),
    )


def family_counts(split: Split, protocol: ProtocolDocument) -> dict[str, int]:
    """Return how many samples count in each family, in taxonomy order, without empty ones."""
    family_of = {task.id: task.family for task in protocol.tasks}
    counts = Counter(family_of[sample.task] for sample in split.counted)
    return {family.id: counts[family.id] for family in protocol.families if counts[family.id]}


def close_to_others(folder: Path) -> None:
    """Make the folder of splits private to its owner, if this process owns and may change it."""
    with suppress(OSError):
        if folder.stat().st_uid == os.geteuid():
            folder.chmod(0o700)


class SplitStore:
    """Finds splits by name and revision, and caches each one until its file changes."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._split_of_revision: dict[tuple[str, str], tuple[Split, SplitPart | None]] = {}
        self._file_of_revision: dict[tuple[str, str], tuple[Path, FileState]] = {}
        self._loaded: dict[tuple[str, str, str], LoadedSplit] = {}
        self._not_found_at_s: dict[tuple[str, str], float] = {}

    def files(self) -> list[Path]:
        """Every split file, the current one of each split first."""
        found = [
            path
            for folder in sorted(self.folder.glob("*/"))
            for path in (*folder.glob("split*.json"), *folder.glob("split*.json.gz"))
        ]
        stem = {path: path.name.removesuffix(".gz") for path in found}
        return sorted(found, key=lambda path: (path.parent.name, len(stem[path]), path.name))

    def current_file(self, name: str) -> Path:
        """Return the current file of a split.

        Raises:
            SplitUnavailableError: There is none for this name.
        """
        found = next((path for path in self.files() if path.parent.name == name), None)
        if found is None:
            where = self.folder.absolute()
            raise SplitUnavailableError(f"there is no split file for {name!r} in {where}")
        return found

    def floors(self, name: str) -> SplitFloors:
        """Return the present floors of a split.

        Raises:
            FloorsUnreadableError: The file is invalid, or there is no split.
        """
        return read_floors(self.folder / name)

    def find(self, name: str, revision: str, protocol: ProtocolDocument) -> LoadedSplit:
        """Return a split at exactly this revision.

        Raises:
            SplitUnavailableError: No file holds this revision.
            SplitRefusedError: It cannot be scored under this protocol.
        """
        key = (name, revision, protocol.digest)
        split, part = self._find_split(name, revision)
        if key not in self._loaded:
            self._loaded[key] = load_split(split, protocol, part)
        return self._loaded[key]

    def missing(self, names: Iterable[str]) -> list[str]:
        """Return which of these splits cannot be used: without a file, or with unreadable floors.

        Followed, as `name@revision`, by revisions of the others that were recently not found. Opens
        no split: while something waits for a revision that was not found, it is looked up again.
        """
        names, since_s = set(names), time.monotonic() - NOT_FOUND_FOR_S
        held = {path.parent.name for path in self.files()}
        unusable = {name for name in names if name not in held or not self._has_floors(name)}
        asked = self._not_found_at_s.copy().items()
        usable = names - unusable
        in_vain = [split for split, at_s in asked if at_s > since_s and split[0] in usable]
        return [*sorted(unusable), *map("@".join, in_vain)]

    def _has_floors(self, name: str) -> bool:
        try:
            self.floors(name)
        except FloorsUnreadableError:
            return False
        return True

    def _find_split(self, name: str, revision: str) -> tuple[Split, SplitPart | None]:
        if not self._lies_there(name, revision):
            seen = self._read_all_of(name)
            if revision not in seen:
                self._not_found_at_s[name, revision] = time.monotonic()
                raise SplitUnavailableError(
                    f"no file holds split {name} at the registered revision {revision}; found "
                    f"{', '.join(sorted(seen)) or 'no readable file'}. Nothing is scored against "
                    "it until the file is back or the split is registered again."
                )
        self._not_found_at_s.pop((name, revision), None)
        return self._split_of_revision[name, revision]

    def _lies_there(self, name: str, revision: str) -> bool:
        held = self._file_of_revision.get((name, revision))
        return held is not None and _file_state(held[0]) == held[1]

    def _read_all_of(self, name: str) -> set[str]:
        seen = set()
        for path in self.files():
            if path.parent.name != name:
                continue
            state = _file_state(path)
            if state is None:
                continue
            try:
                split = read_split(path)
            except SplitUnreadableError:
                continue
            for part in parts_of(split):
                revision = split.part(part).revision
                seen.add(revision)
                self._split_of_revision[split.name, revision] = (split, part)
                self._file_of_revision[split.name, revision] = (path, state)
        return seen


def _file_state(path: Path) -> FileState | None:
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_size, found.st_mtime_ns


def parts_of(split: Split) -> tuple[SplitPart | None, ...]:
    """Return what can be scored of a split: all of it (None), and its parts if it has some."""
    return (None, "public", "private") if split.has_parts else (None,)
