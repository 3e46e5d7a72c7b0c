"""Store drawings that the server may hold: of entries on public splits, and of protocols.

A drawing of an entry shows hazard regions. So storing one takes a `PublicSplit`, which exists only
if the whole split file is public; the table refuses other drawings (`EntryDrawingsRow`).
"""

from collections.abc import Iterator
from dataclasses import dataclass

from sqlalchemy import and_, bindparam, select
from sqlalchemy.orm import Session

from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.database import insert_if_absent
from exceptiondrive_records.db.errors import Violation
from exceptiondrive_records.splits.tables import (
    EntryDrawingsRow,
    ProtocolDrawingRow,
    SamplePictureRow,
    SplitRow,
)
from exceptiondrive_schemas.drawing import (
    EntryDrawings,
    ProtocolDrawing,
    packaged_drawing,
    pictured_digest,
)
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_schemas.split import SplitRef

_PUBLIC_FILE = select(SplitRow.public_file_digest).where(
    SplitRow.name == bindparam("name"), SplitRow.revision == bindparam("revision")
)


@dataclass(frozen=True)
class PublicSplit:
    """A split revision whose whole file is public."""

    ref: SplitRef
    file_digest: str


def find_public_split(session: Session, ref: SplitRef) -> PublicSplit | None:
    """Return the split if it is public; None if it is withheld, so that it must not be drawn."""
    digest = session.scalars(_PUBLIC_FILE, {"name": ref.name, "revision": ref.revision}).first()
    return None if digest is None else PublicSplit(ref, digest)


def drawn_submissions(session: Session, protocol_digest: str, split_revision: str) -> set[str]:
    """Return the submissions that have drawings already."""
    query = select(EntryDrawingsRow.submission_id).where(
        EntryDrawingsRow.protocol_digest == protocol_digest,
        EntryDrawingsRow.split_revision == split_revision,
    )
    return set(session.scalars(query))


def keep_entry_drawings(
    session: Session,
    submission_id: str,
    protocol_digest: str,
    split: PublicSplit,
    drawings: EntryDrawings,
) -> None:
    """Store the drawings of a scored submission; existing ones stay.

    Raises:
        IntegrityError: The split is not public, or the submission has no such score sheet.
    """
    insert_if_absent(
        session,
        EntryDrawingsRow,
        submission_id=submission_id,
        protocol_digest=protocol_digest,
        split_revision=split.ref.revision,
        split_name=split.ref.name,
        public_file_digest=split.file_digest,
        drawings=drawings,
        created_at=database_now(session),
    )


def entry_drawings(
    session: Session, submission_id: str, protocol_digest: str, split_revision: str
) -> EntryDrawings | None:
    """Return the drawings of a scored submission, if there are any."""
    key = (submission_id, protocol_digest, split_revision)
    row = session.get(EntryDrawingsRow, key)
    return None if row is None else row.drawings


def shown_of_withheld_splits(session: Session) -> Iterator[Violation]:
    """Yield drawings and pictures whose split is not public or has changed; there must be none."""
    drawing = "drawing", EntryDrawingsRow, EntryDrawingsRow.submission_id
    picture = "picture", SamplePictureRow, SamplePictureRow.sample_id
    for what, table, subject in (drawing, picture):
        is_its_split = and_(
            SplitRow.name == table.split_name,
            SplitRow.revision == table.split_revision,
            SplitRow.public_file_digest == table.public_file_digest,
        )
        query = select(subject, table.split_name).outerjoin(SplitRow, is_its_split)
        for key, split_name in session.execute(query.where(SplitRow.name.is_(None))):
            text = f"split {split_name} is not public: delete the row from {table.__tablename__}"
            yield Violation(f"{what} of a withheld split", key, text)


def keep_protocol_drawing(session: Session, drawing: ProtocolDrawing) -> None:
    """Store the drawing of a protocol; an existing one stays."""
    insert_if_absent(
        session,
        ProtocolDrawingRow,
        pictured=drawing.pictured,
        drawing=drawing,
        created_at=database_now(session),
    )


def has_protocol_drawing(session: Session, protocol: ProtocolDocument) -> bool:
    """Whether this protocol has a drawing of its own."""
    return protocol_drawing(session, protocol).pictured == pictured_digest(protocol)


def protocol_drawing(session: Session, protocol: ProtocolDocument) -> ProtocolDrawing:
    """Return the drawing of a protocol; until a worker has made it, that of protocol 1.0."""
    pictured = pictured_digest(protocol)
    if packaged_drawing().pictured == pictured:
        return packaged_drawing()
    row = session.get(ProtocolDrawingRow, pictured)
    return packaged_drawing() if row is None else row.drawing
