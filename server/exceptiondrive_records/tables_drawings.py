"""Tables of drawings. Those of entries show hazard regions: of public splits alone."""

from datetime import datetime

from sqlalchemy import ForeignKeyConstraint
from sqlalchemy.orm import Mapped, mapped_column

from exceptiondrive_records.columns import DocumentText
from exceptiondrive_records.db.base import Base
from exceptiondrive_schemas.drawing import EntryDrawings, ProtocolDrawing


class EntryDrawingsRow(Base):
    """What is drawn of one scored submission.

    The database itself refuses a row whose split is not public: `public_file_digest` is never null
    here, and the three columns of the split must be a row of `splits`.
    """

    __tablename__ = "entry_drawings"
    __table_args__ = (
        ForeignKeyConstraint(
            ["submission_id", "protocol_digest", "split_revision"],
            [
                "score_sheets.submission_id",
                "score_sheets.protocol_digest",
                "score_sheets.split_revision",
            ],
        ),
        ForeignKeyConstraint(
            ["split_name", "split_revision", "public_file_digest"],
            ["splits.name", "splits.revision", "splits.public_file_digest"],
        ),
    )
    submission_id: Mapped[str] = mapped_column(primary_key=True)
    protocol_digest: Mapped[str] = mapped_column(primary_key=True)
    split_revision: Mapped[str] = mapped_column(primary_key=True)
    split_name: Mapped[str]
    public_file_digest: Mapped[str]
    drawings: Mapped[EntryDrawings] = mapped_column(DocumentText(EntryDrawings))
    created_at: Mapped[datetime]


class ProtocolDrawingRow(Base):
    """The made-up sample under a protocol, by the digest of what it depends on."""

    __tablename__ = "protocol_drawings"
    pictured: Mapped[str] = mapped_column(primary_key=True)
    drawing: Mapped[ProtocolDrawing] = mapped_column(DocumentText(ProtocolDrawing))
    created_at: Mapped[datetime]
