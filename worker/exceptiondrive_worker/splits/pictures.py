"""Pictures of a public split's samples: read from beside the split, scaled down, and shown.

`NAME/pictures/ID.source.jpg` is the original scene of sample ID, `ID.edited.jpg` the scene with
hazard; `.png` and `.webp` work, too. Stored pictures are always JPEGs re-encoded from the pixels,
without camera metadata and without anything that a browser could take for another type.
"""

import re
from collections.abc import Iterator
from pathlib import Path

from sqlalchemy import select
from sqlalchemy.orm import Session

from exceptiondrive_records.db.database import Database
from exceptiondrive_records.db.errors import RecordsError
from exceptiondrive_records.operations.garbage import remove_orphan
from exceptiondrive_records.splits.drawings import PublicSplit, find_public_split
from exceptiondrive_records.splits.pictures import show_pictures
from exceptiondrive_records.splits.tables import SamplePictureRow
from exceptiondrive_records.submissions.file_store import FileStore
from exceptiondrive_schemas.split import SplitRef
from exceptiondrive_worker.splits.admin import ACTOR
from exceptiondrive_worker.splits.small_jpeg import (
    LONGEST_SIDE_PX,
    MAX_FILE_BYTES,
    PICTURES,
    PictureUnreadableError,
    small_jpeg,
)

MAX_STORED_BYTES = 2 * 2**30
"""Limit for all pictures of a split together."""
_NAME = re.compile(r"(?P<sample_id>.+)\.(?P<shows>source|edited)\.(?:jpe?g|png|webp)")


class PicturesRefusedError(ValueError):
    """Pictures are not shown: the split is withheld, or a file is no picture."""


def publish_pictures(
    database: Database, files: FileStore, split: SplitRef, folder: Path, licence: str
) -> int:
    """Show the pictures beside a public split, replacing those shown before; return their number.

    The licence is shown below each of them. If they are refused, no file remains.

    Raises:
        PicturesRefusedError: The split is withheld, there are no pictures, or a file is none.
        InvalidRecord: A picture is of no sample of the split, or the licence is empty.
    """
    with database.read() as session:
        _public(session, split)
    stored: list[SamplePictureRow] = []
    try:
        stored.extend(_stored(files, folder / PICTURES))  # keeps those before a refused one
        if not stored:
            raise PicturesRefusedError(f"there are no pictures in {split.name}/{PICTURES}")
        _replace_shown(database, files, split, stored, licence)
    except (PicturesRefusedError, RecordsError):
        for row in stored:
            remove_orphan(database, files, row.file_digest)
        raise
    return len(stored)


def remove_pictures(database: Database, files: FileStore, split: SplitRef) -> None:
    """Show no picture of a public split any more, and delete all.

    Raises:
        PicturesRefusedError: The split is withheld: none was ever shown.
    """
    _replace_shown(database, files, split, [], "")


def _replace_shown(
    database: Database, files: FileStore, ref: SplitRef, rows: list[SamplePictureRow], licence: str
) -> None:
    """Replace the pictures shown by these, and delete the files of the former."""
    with database.write() as session:
        split = _public(session, ref)
        of_split = (
            SamplePictureRow.split_name == ref.name,
            SamplePictureRow.split_revision == ref.revision,
        )
        before = session.scalars(select(SamplePictureRow.file_digest).where(*of_split)).all()
        show_pictures(session, split, rows, licence, ACTOR)
    for digest in before:
        remove_orphan(database, files, digest)


def _public(session: Session, ref: SplitRef) -> PublicSplit:
    public = find_public_split(session, ref)
    if public is None:
        raise PicturesRefusedError(
            f"split {ref.name!r} is not public at {ref.revision}: no picture of it is ever shown"
        )
    return public


def _stored(files: FileStore, folder: Path) -> Iterator[SamplePictureRow]:
    """Store the pictures of a folder, and yield the record of each."""
    n_bytes, seen = 0, set()
    for path in sorted(folder.glob("*")):
        found = _NAME.fullmatch(path.name)
        if found is None:
            raise PicturesRefusedError(
                f"{path.name} is not named ID.source or ID.edited, and .jpg, .png or .webp"
            )
        key = found["sample_id"], found["shows"]
        if key in seen:
            raise PicturesRefusedError(f"{path.name} stands there a second time, as another kind")
        seen.add(key)
        with path.open("rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)
        try:
            jpeg, width_px, height_px = small_jpeg(data, LONGEST_SIDE_PX)
        except PictureUnreadableError as refused:
            raise PicturesRefusedError(f"{path.name}: {refused}") from None
        n_bytes += len(jpeg)
        if n_bytes > MAX_STORED_BYTES:
            raise PicturesRefusedError(f"the pictures take more than {MAX_STORED_BYTES} bytes")
        digest, _ = files.put_stream([jpeg], limit_bytes=MAX_FILE_BYTES)
        yield SamplePictureRow(
            sample_id=key[0],
            shows=key[1],
            file_digest=digest,
            width_px=width_px,
            height_px=height_px,
        )
