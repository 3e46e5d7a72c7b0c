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
    """The public facts about a split revision: its manifest and the sizes of its families."""

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
    """Content digest of the whole split file, set for development splits only."""
    registered_at: Mapped[datetime]
    part: Mapped[SplitPart | None] = mapped_column(String)
    """None for the whole split. For a part, the manifest names all samples, and `n_samples` and
    `family_counts` are those of the part; which samples it has is withheld."""
    public_revision: Mapped[str | None]
    """The public part of a whole split with parts; an earlier revision may have the same part."""
    private_revision: Mapped[str | None]
    """As `public_revision`, for the private part."""
    warnings: Mapped[SplitWarnings] = mapped_column(DocumentText(SplitWarnings))
    """Warnings of lint, by count; none for a part."""
    changes: Mapped[SplitChange | None] = mapped_column(DocumentText(SplitChange))
    """Public description of what a later revision changes; for a part, about its samples only."""
    datasheet: Mapped[Datasheet | None] = mapped_column(DocumentText(Datasheet), deferred=True)
    """Public account of how it was made, if its makers gave one."""

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
    """The row stays, so that nobody who has read the signature can post it again."""


class EntryDrawingsRow(Base):
    """The drawings of one scored submission.

    The database itself refuses a row whose split is not public: `public_file_digest` is not
    nullable here, and the three columns of the split are a foreign key to `splits`.
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
    """Digest of a JPEG in the file store."""
    width_px: Mapped[int]
    height_px: Mapped[int]
    licence: Mapped[str]
    """The licence under which it may be shown, in the operator's words."""
    created_at: Mapped[datetime]


class ProtocolDrawingRow(Base):
    """The drawing of a protocol's example sample, by the digest of what it depends on."""

    __tablename__ = "protocol_drawings"
    pictured: Mapped[str] = mapped_column(primary_key=True)
    drawing: Mapped[ProtocolDrawing] = mapped_column(DocumentText(ProtocolDrawing))
    created_at: Mapped[datetime]
