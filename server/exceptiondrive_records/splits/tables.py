"""The tables of splits."""

from datetime import datetime

from sqlalchemy import CheckConstraint, ForeignKey, ForeignKeyConstraint, Index, String
from sqlalchemy.orm import Mapped, mapped_column

from exceptiondrive_records.db.base import Base
from exceptiondrive_records.db.columns import DocumentText
from exceptiondrive_schemas.api.confirmation import Confirmation
from exceptiondrive_schemas.api.phase_settings import SplitPart
from exceptiondrive_schemas.datasheet import (
    NO_RECORDED_DRIVE,
    Datasheet,
    SplitChange,
    SplitWarnings,
)
from exceptiondrive_schemas.drawing import EntryDrawings, ProtocolDrawing
from exceptiondrive_schemas.split import Manifest


class SplitRow(Base):
    """What may be known of a split revision: its manifest and how large its families are."""

    __tablename__ = "splits"
    __table_args__ = (
        Index("uq_splits_public", "name", "revision", "public_file_digest", unique=True),
        CheckConstraint("(public_revision IS NULL) = (private_revision IS NULL)", "ck_both_parts"),
    )
    name: Mapped[str] = mapped_column(primary_key=True)
    revision: Mapped[str] = mapped_column(primary_key=True)
    title: Mapped[str]
    manifest: Mapped[Manifest] = mapped_column(DocumentText(Manifest), deferred=True)
    family_counts: Mapped[dict[str, int]]
    n_samples: Mapped[int]
    public_file_digest: Mapped[str | None]
    """Content digest of the whole split file, for development splits alone."""
    registered_at: Mapped[datetime]
    part: Mapped[SplitPart | None] = mapped_column(String)
    """None: all of it; else a part: its manifest names all samples, and `n_samples` and
    `family_counts` are those of the part. Which samples it has is withheld."""
    public_revision: Mapped[str | None]
    """Of a whole split with parts: its public part, which may be that of an earlier revision, too."""
    private_revision: Mapped[str | None]
    """As `public_revision`, the private part."""
    warnings: Mapped[SplitWarnings] = mapped_column(DocumentText(SplitWarnings))
    """What lint doubts, by count; of a part: nothing."""
    changes: Mapped[SplitChange | None] = mapped_column(DocumentText(SplitChange))
    """What readers are told of a later revision; of a part: of its own samples."""
    datasheet: Mapped[Datasheet | None] = mapped_column(DocumentText(Datasheet), deferred=True)
    """How it was made, as far as anyone may know, where its makers say so."""

    @property
    def counts_private(self) -> bool:
        """Whether samples of a private part count, as the part or within the whole split."""
        return self.part == "private" or self.private_revision is not None

    @property
    def lacks_drives(self) -> bool:
        """Whether no counting sample has a recorded drive, so that source fit is undefined."""
        return self.warnings.count_of(NO_RECORDED_DRIVE) >= self.n_samples


class SplitOpening(Base):
    """A protocol under which a withheld split was opened; only workers add rows, and none is deleted."""

    __tablename__ = "split_openings"
    split_name: Mapped[str] = mapped_column(primary_key=True)
    protocol_digest: Mapped[str] = mapped_column(ForeignKey("protocols.digest"), primary_key=True)
    opened_at: Mapped[datetime]


class ConfirmationRow(Base):
    """An organizer's signed statement that a split revision may be scored under a protocol."""

    __tablename__ = "confirmations"
    __table_args__ = (
        ForeignKeyConstraint(["split_name", "split_revision"], ["splits.name", "splits.revision"]),
        Index("ix_confirmations_asked", "split_name", "split_revision", "protocol_digest"),
    )
    id: Mapped[str] = mapped_column(primary_key=True)
    split_name: Mapped[str]
    split_revision: Mapped[str]
    protocol_digest: Mapped[str]
    confirmation: Mapped[Confirmation] = mapped_column(DocumentText(Confirmation))
    confirmed_at: Mapped[datetime]
    withdrawn_at: Mapped[datetime | None]
    """The row stays, so that whoever once read its signature cannot post it again."""


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


class SamplePictureRow(Base):
    """A camera picture of one sample, stored by its content.

    As with drawings, the database itself refuses a row whose split is not public.
    """

    __tablename__ = "sample_pictures"
    __table_args__ = (
        ForeignKeyConstraint(
            ["split_name", "split_revision", "public_file_digest"],
            ["splits.name", "splits.revision", "splits.public_file_digest"],
        ),
        Index("ix_sample_pictures_file", "file_digest"),
    )
    split_name: Mapped[str] = mapped_column(primary_key=True)
    split_revision: Mapped[str] = mapped_column(primary_key=True)
    sample_id: Mapped[str] = mapped_column(primary_key=True)
    shows: Mapped[str] = mapped_column(primary_key=True)
    """`source`, the original scene, or `edited`, the scene with hazard."""
    public_file_digest: Mapped[str]
    file_digest: Mapped[str]
    """Of a JPEG in the file store."""
    width_px: Mapped[int]
    height_px: Mapped[int]
    licence: Mapped[str]
    """Under which it may be shown, in the operator's words."""
    created_at: Mapped[datetime]


class ProtocolDrawingRow(Base):
    """The drawing of a protocol's example sample, by the digest of what it depends on."""

    __tablename__ = "protocol_drawings"
    pictured: Mapped[str] = mapped_column(primary_key=True)
    drawing: Mapped[ProtocolDrawing] = mapped_column(DocumentText(ProtocolDrawing))
    created_at: Mapped[datetime]
