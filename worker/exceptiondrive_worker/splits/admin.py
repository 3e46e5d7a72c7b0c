"""An operator's actions on splits: add and register them, publish a development split."""

import gzip
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from shutil import copyfile
from tempfile import TemporaryDirectory

from pydantic import ValidationError

from exceptiondrive_records.db.database import Database
from exceptiondrive_records.db.errors import Conflict, RecordsError
from exceptiondrive_records.phases.policy import scored_while_open
from exceptiondrive_records.splits.drawings import find_public_split
from exceptiondrive_records.splits.splits import list_splits, publish_split, register_split
from exceptiondrive_records.submissions.file_store import FileStore
from exceptiondrive_records.submissions.sheets import has_sheets
from exceptiondrive_schemas.api.phase_settings import SplitPart
from exceptiondrive_schemas.check.inflate import GZIP_MAGIC
from exceptiondrive_schemas.datasheet import Datasheet, SplitChange, SplitWarnings
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.split import Manifest, Split, SplitRef
from exceptiondrive_schemas.submission_files import PlanningSubmission
from exceptiondrive_scoring.split_lint import LintWarning
from exceptiondrive_worker.splits.faults import SplitRefusedError
from exceptiondrive_worker.splits.floors import FLOORS_FILE, FloorsUnreadableError
from exceptiondrive_worker.splits.store import (
    MAX_SPLIT_BYTES,
    SplitStore,
    SplitUnavailableError,
    SplitUnreadableError,
    datasheet_beside,
    family_counts,
    load_split,
    parts_of,
    read_datasheet,
    read_split,
)
from exceptiondrive_worker.splits.warnings import split_warnings

ACTOR = "operator"
_REFUSALS = (
    SplitUnreadableError,
    SplitRefusedError,
    SplitUnavailableError,
    FloorsUnreadableError,
    RecordsError,
)


@dataclass(frozen=True)
class RegisteredSplit:
    """A split file, what was recorded of it, and the warnings of lint."""

    path: Path
    manifest: Manifest
    warnings: tuple[LintWarning, ...]
    has_parts: bool


class SplitsRefusedError(ValueError):
    """Some files could not be registered, each with its reason; those in `registered` were."""

    def __init__(
        self, registered: list[RegisteredSplit], refused: Mapping[Path, Exception]
    ) -> None:
        self.registered = registered
        super().__init__("\n".join(f"{path}: {error}" for path, error in refused.items()))


def register_all_splits(
    database: Database, splits: SplitStore, protocol: ProtocolDocument, words: str = ""
) -> list[RegisteredSplit]:
    """Register the manifest of every split file; those registered already are not changed.

    The current file of a split comes last, because new phases take the revision registered last. A
    refused file does not keep others from being registered. Readers of a new revision see `words`
    if no datasheet says what changed.

    Raises:
        SplitUnavailableError: There is no file.
        SplitsRefusedError: A file is no split, cannot be scored (every offending sample is listed),
            lies in a folder of another name, or has unreadable floors beside it.
    """
    paths = splits.files()
    if not paths:
        raise SplitUnavailableError(
            f"there is no split in {splits.folder.absolute()}, as NAME/split.json.gz. Run this where the "
            "server was started, or name the folder: EXCEPTIONDRIVE_SPLITS_DIR"
        )
    current = {path.parent: path for path in reversed(paths)}
    registered, refused = [], {}
    for path in sorted(paths, key=lambda path: path == current[path.parent]):
        try:
            registered.append(_register(database, splits, path, protocol, words))
        except _REFUSALS as error:
            refused[path] = error
    if refused:
        raise SplitsRefusedError(registered, refused)
    return registered


def add_split_file(
    database: Database,
    splits: SplitStore,
    source: Path,
    protocol: ProtocolDocument,
    words: str,
) -> RegisteredSplit:
    """Copy a split file, and the datasheet beside it, to where workers look for it; register it.

    For a revision that is there already, current or earlier, only the datasheet is replaced. The
    file of an earlier revision stays beside the current one, under a number, so that entries scored
    against it can be scored again. A later revision needs words for readers, from its datasheet or
    from `words`.

    Raises:
        SplitUnreadableError: It is no split, or the datasheet beside it is none, or not its own.
        SplitRefusedError: It cannot be scored.
        SplitUnavailableError: Another revision is there, and there are no words about the change,
            or not those of the datasheet, or its samples or their parts differ; or it is the first
            with parts, and some file has been scored on the whole.
        FloorsUnreadableError: The floors beside the split cannot be read. Errors leave
            nothing copied.
    """
    split = read_split(source)
    load_split(split, protocol)
    if splits.folder.joinpath(split.name, FLOORS_FILE).exists():
        splits.floors(split.name)  # raises if unreadable
    sheet = _sheet_of(split, source) if source.name.startswith("split") else None
    said = sheet.changes.words if sheet is not None and sheet.changes is not None else ""
    folder = splits.folder / split.name
    held = [path for path in splits.files() if path.parent == folder]
    same = [path for path in held if read_split(path).revision == split.revision]
    if not same:
        if held and not words and not said:
            raise SplitUnavailableError(
                f"{held[0]} holds another revision of split {split.name!r}. To add this one beside "
                "it, say what readers are told of the change: exceptiondrive-worker add-split "
                f'{source} --words "..."'
            )
        if held and words and said and words != said:
            raise SplitUnavailableError(
                f"{datasheet_beside(source)} says what readers are told of the change: {said!r}. Leave "
                "--words out, or freeze the revision with other words"
            )
        if held:
            current = read_split(held[0])
            _require_same_samples(current, split)
            _require_same_parts(current, split)
        _require_parts_in_time(database, split)
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        number = next(n for n in count(len(held)) if not any(folder.glob(f"*-{n}.*")))
        for path in (*folder.glob("split.json*"), *folder.glob("datasheet.json")):
            path.rename(path.with_name(path.name.replace(".", f"-{number}.", 1)))
        held = same = [folder / f"split.json{'.gz' if _is_gzipped(source) else ''}"]
        _copy(source, held[0])
    if sheet is not None and datasheet_beside(source) != datasheet_beside(same[0]):
        _copy(datasheet_beside(source), datasheet_beside(same[0]))
    return _register(database, splits, held[0], protocol, words)


def _sheet_of(split: Split, source: Path) -> Datasheet | None:
    """Return the datasheet beside a split file, which must belong to the split."""
    sheet = read_datasheet(source)
    if sheet is not None and (sheet.name, sheet.revision) != (split.name, split.revision):
        raise SplitUnreadableError(
            f"{datasheet_beside(source).name} is of split {sheet.name!r} at revision "
            f"{sheet.revision}, and the split is {split.name!r} at {split.revision}: put its own "
            "beside it, or none"
        )
    return sheet


def _require_same_samples(earlier: Split, later: Split) -> None:
    """Refuse a revision with other samples: present phases could not use it, and new ones would."""
    before = {sample.sample_id for sample in earlier.samples}
    after = {sample.sample_id for sample in later.samples}
    if before == after:
        return
    named = ", ".join(sorted(before ^ after)[:3])
    raise SplitUnavailableError(
        f"This revision of split {later.name!r} lacks {len(before - after)} samples and has "
        f"{len(after - before)} that no file answers ({named}). A later revision holds the same "
        'samples: mark those that no longer count with "withdrawn": "why", or give another set of '
        "samples another name."
    )


def _require_same_parts(earlier: Split, later: Split) -> None:
    """Refuse a revision that moves samples between parts: private ones might be scored early."""
    part_of = {sample.sample_id: sample.part for sample in earlier.samples}
    moved = [it for it in later.samples if part_of.get(it.sample_id) not in (None, it.part)]
    if moved:
        named = ", ".join(sorted(it.sample_id for it in moved)[:3])
        raise SplitUnavailableError(
            f"This revision of split {later.name!r} takes {len(moved)} samples out of the part that they "
            f'are of ({named}). A later revision keeps the part of each sample: put "part" back as it '
            f"stands in revision {earlier.revision}, or give the split another name."
        )


def _require_parts_in_time(database: Database, split: Split) -> None:
    """Refuse a first revision with parts once the whole is scored, with its private samples."""
    with database.read() as session:
        known = (row for row in list_splits(session) if row.name == split.name)
        is_first = split.has_parts and not any(row.private_revision for row in known)
        if is_first and has_sheets(session, split.name):
            raise SplitUnavailableError(
                f"Files are scored on all samples of split {split.name!r}, and this revision parts them: "
                "what would be private is scored before its time. Leave its parts out, or give the parted "
                "split another name."
            )


def with_drives(split: Split, drives: PlanningSubmission, *, are_public: bool) -> Split:
    """Return a split with recorded drives: the source trajectories of a file about it.

    If the drives are public, everybody has them: local checks then detect a wrong time step.

    Raises:
        SplitUnreadableError: The file is of another split, or holds none of its drives.
    """
    source_of = {each.sample_id: each.source for each in drives.predictions}
    known = [sample for sample in split.samples if source_of.get(sample.sample_id) is not None]
    if drives.split != split.name or not known:
        raise SplitUnreadableError(
            f"the drives are of split {drives.split!r}, and hold {len(known)} of the "
            f"{len(split.samples)} samples of split {split.name!r}"
        )
    samples = [
        sample.model_copy(update={"recorded": source_of.get(sample.sample_id) or sample.recorded})
        for sample in split.samples
    ]
    told = {"samples": tuple(samples), "recorded_is_public": are_public}
    return Split.model_validate(split.model_copy(update=told).model_dump(by_alias=True))


def read_drives(path: Path) -> PlanningSubmission:
    """Read a trajectory file, gzipped or not, of any size that a split may have.

    Raises:
        SplitUnreadableError: It is none.
    """
    data = path.read_bytes()
    try:
        return PlanningSubmission.model_validate_json(
            gzip.decompress(data) if _is_gzipped(path) else data
        )
    except (ValidationError, OSError, EOFError, zlib.error) as error:
        raise SplitUnreadableError(
            f"{path.name} is no trajectory file ({type(error).__name__}); exceptiondrive check "
            "says why"
        ) from None


def _is_gzipped(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(2) == GZIP_MAGIC


def _copy(source: Path, target: Path) -> None:
    """Copy a file atomically, readable for its owner alone."""
    with TemporaryDirectory(dir=target.parent) as folder:
        half = Path(folder) / target.name
        copyfile(source, half)
        half.chmod(0o600)
        half.replace(target)


def publish_split_file(
    database: Database,
    files: FileStore,
    splits: SplitStore,
    name: str,
    protocol: ProtocolDocument,
    *,
    while_open: bool = False,
) -> RegisteredSplit:
    """Make the current file of a split public, regions and all: for development splits only.

    It is registered if it was not yet.

    Raises:
        SplitUnavailableError: There is no file for this name.
        Conflict: A phase on it is open and has scores, and `while_open` is not set.
    """
    path = splits.current_file(name)
    with database.read() as session:
        is_public = find_public_split(session, read_split(path).ref) is not None
        tested = [] if is_public or while_open else scored_while_open(session, name)
    if tested:
        raise Conflict(
            f"Split {name!r} is withheld, and files of {', '.join(tested)} are scored on it: once it is "
            "public whoever submits can read the answers. Close the phase first, or publish it "
            "--while-open."
        )
    registered = _register(database, splits, path, protocol, is_public=True)
    digest, _ = files.put_stream([path.read_bytes()], limit_bytes=MAX_SPLIT_BYTES)
    with database.write() as session:
        publish_split(session, name, registered.manifest.revision, digest, ACTOR)
    return registered


def current_split(splits: SplitStore, name: str) -> tuple[SplitRef, Path]:
    """Return the current split of a name, and the folder of its file.

    Raises:
        SplitUnavailableError: There is no file for this name.
        SplitUnreadableError: It is no split.
    """
    path = splits.current_file(name)
    split = read_split(path)
    return split.ref, path.parent


def _register(
    database: Database,
    splits: SplitStore,
    path: Path,
    protocol: ProtocolDocument,
    words: str = "",
    *,
    is_public: bool = False,
) -> RegisteredSplit:
    """Record the whole split and each part, if it has parts; return the whole.

    Lint treats a split as withheld unless it is public, or about to be.
    """
    split = read_split(path)
    if path.parent.name != split.name:
        raise SplitUnavailableError(
            f"it holds split {split.name!r}, which workers look for in a folder of that name: "
            f"rename {path.parent} to {split.name}"
        )
    floors = splits.floors(split.name)  # raises if unreadable
    for earlier in _earlier_revisions(database, splits, split):
        _require_same_parts(earlier, split)
    _require_parts_in_time(database, split)
    loaded = {part: load_split(split, protocol, part) for part in parts_of(split)}
    parts = {part: each.manifest.revision for part, each in loaded.items() if part is not None}
    with database.read() as session:
        is_public = is_public or find_public_split(session, split.ref) is not None
    least = 1 if is_public else floors.min_samples_per_cell
    whole, warnings = loaded[None].manifest, split_warnings(split, protocol, least)
    sheet = read_datasheet(path)
    changes = _changes(database, splits, split, sheet, words)
    with database.write() as session:
        for part, of_part in loaded.items():
            register_split(
                session,
                of_part.manifest,
                family_counts(split.part(part), protocol),
                ACTOR,
                n_aside=len(split.samples) - len(split.counted) if part is None else 0,
                part=part,
                parts=parts if part is None else {},
                warnings=SplitWarnings(found=() if part else tuple(w.told for w in warnings)),
                changes=changes.get(part),
                datasheet=sheet if part is None else None,
            )
    return RegisteredSplit(path, whole, warnings, has_parts=bool(parts))


def _earlier_revisions(database: Database, splits: SplitStore, split: Split) -> Iterator[Split]:
    """Yield the registered revisions beside one that is not registered yet."""
    with database.read() as session:
        known = {row.revision for row in list_splits(session) if row.name == split.name}
    if split.revision not in known:
        beside = (path for path in splits.files() if path.parent.name == split.name)
        yield from (each for each in map(read_split, beside) if each.revision in known)


def _changes(
    database: Database, splits: SplitStore, split: Split, sheet: Datasheet | None, words: str
) -> dict[SplitPart | None, SplitChange]:
    """Return the changes to publish of a later revision, and of each part that is new in it.

    The previous revision is the one that the datasheet names; without one, and if this revision is
    not registered yet, it is the newest registered one whose file is still there.
    """
    said = sheet.changes if sheet else None
    with database.read() as session:
        rows = [row for row in list_splits(session) if row.name == split.name]
    known = [row.revision for row in rows]
    others = [row for row in rows if row.revision != split.revision]
    told_already = {it for row in others for it in (row.public_revision, row.private_revision)}
    if said is not None:
        words, known = said.words, [said.previous]
    elif not words or split.revision in known:
        return {}
    files = (read_split(path) for path in splits.files() if path.parent.name == split.name)
    earlier = {each.revision: each for each in files}
    before = next((earlier[revision] for revision in known if revision in earlier), None)
    if before is None:
        return {} if said is None else {None: said}
    told: dict[SplitPart | None, SplitChange] = {}
    for part in parts_of(split):
        old, new = before.part(part), split.part(part)
        if new.revision not in (old.revision, *told_already):
            told[part] = SplitChange.between(old, new, words)
    return told if said is None else {**told, None: said}
