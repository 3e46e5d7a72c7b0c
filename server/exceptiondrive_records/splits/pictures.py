"""Store pictures of samples that the server may hold: of public splits, with their licence.

As with drawings, the table refuses those of a split that is not public (`tables.SamplePictureRow`).
"""

from collections.abc import Iterable

from sqlalchemy import ColumnElement, delete, exists, select
from sqlalchemy.orm import Session

from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import InvalidRecord
from exceptiondrive_records.splits.drawings import PublicSplit
from exceptiondrive_records.splits.splits import manifest_of
from exceptiondrive_records.splits.tables import SamplePictureRow
from exceptiondrive_schemas.base import content_digest
from exceptiondrive_schemas.split import SplitRef

MAX_LICENCE_LENGTH = 300


def show_pictures(
    session: Session,
    split: PublicSplit,
    pictures: Iterable[SamplePictureRow],
    licence: str,
    actor: str,
) -> None:
    """Replace the shown pictures of a split by these; an empty sequence removes all.

    Each has its sample, what it shows, stored file and size; this function sets the other columns.
    The licence is shown under each picture; it may be empty if there are none.

    Raises:
        InvalidRecord: A sample is not in the split, or the licence is not one line of text.
        IntegrityError: The split is not public.
    """
    shown = list(pictures)
    if shown and not (licence.strip() and licence.isprintable()):
        raise InvalidRecord(
            "Say in one line of words under which licence the pictures may be shown."
        )
    if len(licence) > MAX_LICENCE_LENGTH:
        raise InvalidRecord(f"The words of the licence are longer than {MAX_LICENCE_LENGTH}.")
    known = set(manifest_of(session, split.ref.name, split.ref.revision).sample_ids)
    strange = sorted({picture.sample_id for picture in shown} - known)
    if strange:
        raise InvalidRecord(
            f"{len(strange)} samples with pictures are not in split {split.ref.name!r} at "
            f"{split.ref.revision}, {strange[0]!r} first."
        )
    session.execute(delete(SamplePictureRow).where(*_is_of(split.ref)))
    now = database_now(session)
    for picture in shown:
        picture.split_name, picture.split_revision = split.ref.name, split.ref.revision
        picture.public_file_digest = split.file_digest
        picture.licence, picture.created_at = licence.strip(), now
    session.add_all(shown)
    session.flush()
    files = sorted((each.sample_id, each.shows, each.file_digest) for each in shown)
    detail = {
        "revision": split.ref.revision,
        "n_pictures": len(files),
        "digest": content_digest(files),
        "licence": licence.strip(),
    }
    audit(session, actor, "pictures shown", split.ref.name, detail)


def pictures_of(
    session: Session, split: SplitRef, sample_ids: Iterable[str]
) -> dict[str, tuple[SamplePictureRow, ...]]:
    """Return pictures by sample, the original scene first; samples without any are left out."""
    wanted = SamplePictureRow.sample_id.in_(set(sample_ids))
    order = SamplePictureRow.sample_id, SamplePictureRow.shows.desc()
    rows = session.scalars(select(SamplePictureRow).where(*_is_of(split), wanted).order_by(*order))
    found: dict[str, tuple[SamplePictureRow, ...]] = {}
    for row in rows:
        found[row.sample_id] = (*found.get(row.sample_id, ()), row)
    return found


def shows_picture(session: Session, split_name: str, file_digest: str) -> bool:
    """Whether a stored file is a picture of a public split."""
    stands = SamplePictureRow.split_name == split_name, SamplePictureRow.file_digest == file_digest
    return bool(session.scalar(select(exists().where(*stands))))


def _is_of(split: SplitRef) -> tuple[ColumnElement[bool], ColumnElement[bool]]:
    return (
        SamplePictureRow.split_name == split.name,
        SamplePictureRow.split_revision == split.revision,
    )
