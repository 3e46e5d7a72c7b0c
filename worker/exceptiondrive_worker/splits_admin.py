"""What an operator does with splits: register their manifests, publish a development split."""

from dataclasses import dataclass
from pathlib import Path

from pydantic import ValidationError

from exceptiondrive_records.db.database import Database
from exceptiondrive_records.splits.splits import list_splits, publish_split, register_split
from exceptiondrive_records.submissions.file_store import FileStore
from exceptiondrive_schemas.datasheet import Datasheet, SplitChange, SplitWarning, SplitWarnings
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.split import Manifest, Split, SplitRef
from exceptiondrive_scoring.split_lint import LintWarning
from exceptiondrive_worker.split_store import (
    MAX_SPLIT_BYTES,
    SplitStore,
    SplitUnreadableError,
    family_counts,
    load_split,
    parts_of,
    read_split,
)
from exceptiondrive_worker.split_warnings import split_warnings

ACTOR = "operator"


@dataclass(frozen=True)
class RegisteredSplit:
    """A split file, what was recorded of it, and what lint doubts."""

    path: Path
    manifest: Manifest
    warnings: tuple[LintWarning, ...]


def register_all_splits(
    database: Database, splits: SplitStore, protocol: ProtocolDocument, words: str = ""
) -> list[RegisteredSplit]:
    """Register the manifest of every split file; what is registered already stays as it is.

    Args:
        database: The system of record.
        splits: Where the files lie.
        protocol: Under which they have to be scorable.
        words: What readers are told of a revision that is new and has no datasheet that says it.

    Raises:
        SplitUnreadableError: A file is not a split.
        SplitRefusedError: A split cannot be scored; every offending sample is listed.
        FloorsUnreadableError: The floors beside a split cannot be read.
    """
    return [_register(database, splits, path, protocol, words) for path in splits.files()]


def publish_split_file(
    database: Database, files: FileStore, splits: SplitStore, name: str, protocol: ProtocolDocument
) -> RegisteredSplit:
    """Make the current file of a split public, regions and all: for development splits only.

    Raises:
        SplitUnavailableError: There is no file for this name.
    """
    path = splits.current_file(name)
    registered = _register(database, splits, path, protocol)
    digest, _ = files.put_stream([path.read_bytes()], limit_bytes=MAX_SPLIT_BYTES)
    with database.write() as session:
        publish_split(session, name, registered.manifest.revision, digest, ACTOR)
    return registered


def current_split(splits: SplitStore, name: str) -> tuple[SplitRef, Path]:
    """Return which split the current file of a name is, and the folder in which it lies.

    Raises:
        SplitUnavailableError: There is no file for this name.
        SplitUnreadableError: It is no split.
    """
    path = splits.current_file(name)
    split = read_split(path)
    return SplitRef(name=split.name, revision=split.revision), path.parent


def _register(
    database: Database, splits: SplitStore, path: Path, protocol: ProtocolDocument, words: str = ""
) -> RegisteredSplit:
    """Record the whole split and, where it has parts, each part; return the whole."""
    split = read_split(path)
    splits.floors(split.name)  # refuses what cannot be read
    loaded = {part: load_split(split, protocol, part) for part in parts_of(split)}
    whole, warnings = loaded[None].manifest, split_warnings(split, protocol)
    counts = [SplitWarning(code=w.code, what=w.what, count=w.count) for w in warnings]
    sheet = read_datasheet(path)
    changes = sheet.changes if sheet else _changes(database, splits, split, words)
    with database.write() as session:
        for part, of_part in loaded.items():
            register_split(
                session,
                of_part.manifest,
                family_counts(split if part is None else split.part(part), protocol),
                ACTOR,
                n_aside=len(split.samples) - len(split.counted) if part is None else 0,
                part=part,
                whole_revision=None if part is None else whole.revision,
                warnings=SplitWarnings(found=tuple(counts if part is None else ())),
                changes=changes if part is None else None,
                datasheet=sheet if part is None else None,
            )
    return RegisteredSplit(path, whole, warnings)


def _changes(
    database: Database, splits: SplitStore, split: Split, words: str
) -> SplitChange | None:
    """Return what is told of a revision that is not registered yet, since the one before."""
    with database.read() as session:
        known = [row.revision for row in list_splits(session) if row.name == split.name]
    if not words or split.revision in known:
        return None
    files = (read_split(path) for path in splits.files() if path.parent.name == split.name)
    earlier = {each.revision: each for each in files}
    before = next((earlier[revision] for revision in known if revision in earlier), None)
    return None if before is None else SplitChange.between(before, split, words)


def read_datasheet(split_path: Path) -> Datasheet | None:
    """Return the datasheet that lies beside a split file, if there is one.

    `split.json.gz` has `datasheet.json`, and `split-2026.json.gz` has `datasheet-2026.json`.

    Raises:
        SplitUnreadableError: It is no datasheet.
    """
    name = split_path.name.split(".json")[0].replace("split", "datasheet", 1)
    path = split_path.with_name(f"{name}.json")
    if not path.exists():
        return None
    try:
        return Datasheet.model_validate_json(path.read_bytes())
    except (OSError, ValidationError) as error:
        raise SplitUnreadableError(
            f"{path.name} is no datasheet ({type(error).__name__})"
        ) from None
