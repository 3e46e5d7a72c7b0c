"""Record what the server may know of a split: manifest and family sizes, never a region or task."""

from collections.abc import Mapping
from datetime import UTC

from sqlalchemy import bindparam, or_, select
from sqlalchemy.orm import Session, undefer

from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import Conflict, InvalidRecord, NotFound
from exceptiondrive_records.db.last import do_last
from exceptiondrive_records.splits.tables import SplitRow
from exceptiondrive_schemas.api.phase_settings import LivePart, SplitPart
from exceptiondrive_schemas.datasheet import Datasheet, SplitChange, SplitWarnings
from exceptiondrive_schemas.split import Manifest, SplitRef

NO_WARNINGS = SplitWarnings()
NO_PARTS: Mapping[SplitPart, str] = {}
_LOCKED_REVISIONS = (
    select(SplitRow.revision)
    .where(SplitRow.name == bindparam("split"))
    .order_by(SplitRow.revision)
    .with_for_update(key_share=True)
)


def register_split(
    session: Session,
    manifest: Manifest,
    family_counts: dict[str, int],
    actor: str,
    *,
    n_aside: int = 0,
    part: SplitPart | None = None,
    parts: Mapping[SplitPart, str] = NO_PARTS,
    warnings: SplitWarnings = NO_WARNINGS,
    changes: SplitChange | None = None,
    datasheet: Datasheet | None = None,
) -> SplitRow:
    """Record a split revision; for a known one, update its warnings, changes and datasheet.

    Args:
        session: Session of a write transaction.
        manifest: Public part of the split.
        family_counts: Samples that count per family; with `n_aside` they add up to all samples.
        actor: Who registers it.
        n_aside: Samples that are answered and do not count: controls and withdrawn ones.
        part: Set for a part of a split: its manifest names the samples of the whole, and the counts
            are those of the part; which samples it has is never recorded.
        parts: The revisions of the parts of a whole split.
        warnings: Warnings of lint, by count.
        changes: Public description of what a later revision changes.
        datasheet: Public account of how it was made.

    Raises:
        InvalidRecord: The counts do not add up, or the datasheet is of another split.
        Conflict: The revision is known with another manifest, other counts or other parts, or it
            has no parts though the split does.
    """
    n_samples = sum(family_counts.values())
    n_named = len(manifest.sample_ids)
    if n_samples + n_aside != n_named and (part is None or n_samples > n_named):
        raise InvalidRecord(
            f"The family counts of split {manifest.name!r} add up to {n_samples}, but it has "
            f"{n_named} samples, {n_aside} of which count in none."
        )
    if datasheet is not None and (datasheet.name, datasheet.revision) != (
        manifest.name,
        manifest.revision,
    ):
        raise InvalidRecord(
            f"The datasheet is of split {datasheet.name!r} at revision {datasheet.revision}, the "
            f"split is {manifest.name!r} at {manifest.revision}."
        )
    held = session.get(SplitRow, (manifest.name, manifest.revision), options=[undefer("*")])
    if held is not None:
        known = (held.manifest, held.family_counts, held.public_revision, held.private_revision)
        if known != (manifest, family_counts, parts.get("public"), parts.get("private")):
            raise Conflict(
                f"Split {manifest.name!r} revision {manifest.revision} is recorded otherwise; "
                "a revision never changes."
            )
        if datasheet is not None and held.datasheet not in (None, datasheet):
            told = {"revision": manifest.revision}
            audit(session, actor, "datasheet replaced", manifest.name, told)
        held.warnings = warnings
        held.changes, held.datasheet = changes or held.changes, datasheet or held.datasheet
        return held
    has_parts = SplitRow.name == manifest.name, SplitRow.private_revision.is_not(None)
    if (
        part is None
        and not parts
        and session.scalars(select(SplitRow.name).where(*has_parts)).first()
    ):
        raise Conflict(
            f"Split {manifest.name!r} has parts, and revision {manifest.revision} has none: its private "
            'samples would count with the others. Put "part" of each sample back into the file.'
        )
    row = SplitRow(
        name=manifest.name,
        revision=manifest.revision,
        title=manifest.title,
        manifest=manifest,
        family_counts=dict(family_counts),
        n_samples=n_samples,
        public_file_digest=None,
        registered_at=database_now(session),
        part=part,
        public_revision=parts.get("public"),
        private_revision=parts.get("private"),
        warnings=warnings,
        changes=changes,
        datasheet=datasheet,
    )
    session.add(row)
    session.flush()
    detail = {"revision": manifest.revision, "n_samples": n_samples, "part": part}
    audit(session, actor, "split registered", manifest.name, detail)
    return row


def publish_split(
    session: Session, name: str, revision: str, file_digest: str, actor: str
) -> SplitRow:
    """Mark a split, and its parts, as a development split, whose whole file is public.

    Raises:
        NotFound: No such split.
        Conflict: It was published with another file.
    """
    row = find_split(session, name, revision)
    if row.public_file_digest == file_digest:
        return row
    if row.public_file_digest is not None:
        raise Conflict(f"Split {name!r} was published as another file ({row.public_file_digest}).")
    parts = [part for part in (row.public_revision, row.private_revision) if part is not None]
    for each in (row, *(find_split(session, name, part) for part in parts)):
        each.public_file_digest = each.public_file_digest or file_digest
    audit(
        session, actor, "split published", name, {"revision": revision, "file_digest": file_digest}
    )
    return row


def find_split(session: Session, name: str, revision: str | None = None) -> SplitRow:
    """Return a split revision, by default the whole one registered last.

    Raises:
        NotFound: There is none.
    """
    query = select(SplitRow).where(SplitRow.name == name)
    if revision is None:
        query = query.where(SplitRow.part.is_(None))
    else:
        query = query.where(SplitRow.revision == revision)
    row = session.scalars(query.order_by(SplitRow.registered_at.desc()).limit(1)).first()
    if row is None and revision is not None:
        raise NotFound(f"registered revision of split {name!r} like", revision)
    if row is None:
        raise NotFound("split", name)
    return row


def whole_split(session: Session, name: str, revision: str) -> SplitRow:
    """Return the whole split of a revision; for a part, the one registered last that has it.

    Raises:
        NotFound: There is none.
    """
    row = find_split(session, name, revision)
    if row.part is None:
        return row
    has_it = or_(SplitRow.public_revision == revision, SplitRow.private_revision == revision)
    query = select(SplitRow).where(SplitRow.name == name, has_it)
    whole = session.scalars(query.order_by(SplitRow.registered_at.desc()).limit(1)).first()
    if whole is None:
        raise NotFound(f"whole split {name!r} with a part like", revision)
    return whole


def part_revision(session: Session, name: str, revision: str, part: SplitPart | None) -> str | None:
    """Return the revision of a part, or of the whole for None; None if it has no parts."""
    whole = whole_split(session, name, revision)
    parts = {"public": whole.public_revision, "private": whole.private_revision}
    return whole.revision if part is None else parts[part]


def live_revision(session: Session, name: str, revision: str, live_part: LivePart) -> str:
    """Return the revision that a live board counts: as `live_part` says, if the split has parts."""
    public = part_revision(session, name, revision, "public") if live_part == "public" else None
    return public or whole_split(session, name, revision).revision


def lock_split(session: Session, name: str) -> None:
    """Lock a split until the transaction ends, so that what it reveals is counted serially."""
    session.execute(_LOCKED_REVISIONS, {"split": name}).all()


def lock_split_last(session: Session, name: str) -> None:
    """Defer `lock_split` to the end of the write transaction."""
    do_last(session, _LOCKED_REVISIONS, {"split": name}, is_shared=True)


def list_splits(session: Session) -> list[SplitRow]:
    """Return all split revisions by name, newest first."""
    order = (SplitRow.name, SplitRow.registered_at.desc())
    return list(session.scalars(select(SplitRow).order_by(*order)))


def words_of_revision(split: SplitRow) -> str:
    """Describe a split revision: its date, how many samples count, and its makers' words."""
    told = f": {split.changes.words}" if split.changes is not None else ""
    part = f" of the {split.part} part" if split.part is not None else ""
    day = f"{split.registered_at.astimezone(UTC):%Y-%m-%d %H:%M}"
    return f"{day} UTC, {split.n_samples:,} samples{part}{told}"


def manifest_of(session: Session, name: str, revision: str | None = None) -> Manifest:
    """Return the manifest of a split.

    Raises:
        NotFound: There is no such split.
    """
    return find_split(session, name, revision).manifest


def newly_counted(session: Session, old: SplitRef, new: SplitRef) -> str | None:
    """Describe the part of a split that newly counts at a revision; None if it counted before."""
    before, part = (find_split(session, each.name, each.revision).part for each in (old, new))
    return None if before == part else part_words(part)


def part_words(part: str | None) -> str:
    """Describe which samples count."""
    return f"the {part} part" if part else "all samples"
