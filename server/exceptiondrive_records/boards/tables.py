"""The tables of boards."""

from datetime import datetime
from typing import ClassVar

from sqlalchemy import ForeignKey, Index, Text, UniqueConstraint, exists, func, select
from sqlalchemy.orm import Mapped, column_property, mapped_column

from exceptiondrive_records.db.base import Base
from exceptiondrive_records.db.columns import DocumentText
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_schemas.board import BoardLeader, BoardNews
from exceptiondrive_schemas.reported.imported import ImportedRows


class BoardRow(Base):
    """An immutable board snapshot: `body` holds the exact bytes that are served."""

    __tablename__ = "boards"
    __table_args__ = (UniqueConstraint("phase_id", "number"),)
    id: Mapped[int] = mapped_column(primary_key=True)
    phase_id: Mapped[str] = mapped_column(ForeignKey("phases.id", ondelete="CASCADE"))
    protocol_digest: Mapped[str] = mapped_column(ForeignKey("protocols.digest"))
    split_revision: Mapped[str]
    number: Mapped[int]
    digest: Mapped[str]
    """Digest of the content without number and date (`Board.content_digest`)."""
    body_digest: Mapped[str]
    """Digest of `body`: the strong ETag."""
    published_at: Mapped[datetime]
    """When it was built. Readers see `told_at` instead."""
    told_at: ClassVar[Mapped[datetime]]
    """When readers first saw it; for a former draft that is later than it was built."""
    view: Mapped[str] = mapped_column(default="main")
    """`main`, or `late`: the board with late entries among the others."""
    leader: Mapped[BoardLeader | None] = mapped_column(DocumentText(BoardLeader), default=None)
    """Its leader, copied here so that the history need not read any board."""
    body: Mapped[str] = mapped_column(Text, deferred=True)
    """Loaded only on access: 22 MB for a board of 10,000 entries. It is the last column, because
    SQLite reads through a text to reach the columns after it."""
    forgotten: ClassVar[Mapped[str | None]]
    """Its submissions of forgotten teams, each with the alias of its team, one per line; None if
    there are none."""

    @property
    def told(self) -> str:
        """A key of the board as readers get it: equal keys mean equal content."""
        return told_as(self.body_digest, self.told_at, self.forgotten)


def told_as(body_digest: str, told_at: datetime, forgotten: str | None) -> str:
    """Return a key of a board as readers get it."""
    return f"{body_digest} {told_at} {forgotten or ''}"


class BoardFlip(Base):
    """Append-only history of the pointer `Phase.current_board_id`."""

    __tablename__ = "board_flips"
    __table_args__ = (
        Index("ix_board_flips_phase", "phase_id", "at"),
        Index("ix_board_flips_board", "board_id", "at"),
    )
    id: Mapped[int] = mapped_column(primary_key=True)
    phase_id: Mapped[str] = mapped_column(ForeignKey("phases.id", ondelete="CASCADE"))
    board_id: Mapped[int] = mapped_column(ForeignKey("boards.id", ondelete="CASCADE"))
    at: Mapped[datetime]
    news: Mapped[BoardNews] = mapped_column(DocumentText(BoardNews))
    """The changed scores, copied here so that the history need not read any board."""


_FIRST_FLIP = (
    select(func.min(BoardFlip.at))
    .where(BoardFlip.board_id == BoardRow.id)
    .correlate_except(BoardFlip)
)
BoardRow.told_at = column_property(
    func.coalesce(_FIRST_FLIP.scalar_subquery(), BoardRow.published_at)
)


class BoardEntryRow(Base):
    """A submission on a board; written with the board, immutable.

    Rows reported by the paper are not submissions, and have no row here.
    """

    __tablename__ = "board_entries"
    __table_args__ = (Index("ix_board_entries_submission", "submission_id", "board_id"),)
    board_id: Mapped[int] = mapped_column(ForeignKey("boards.id"), primary_key=True)
    submission_id: Mapped[str] = mapped_column(primary_key=True)
    rank: Mapped[int | None]


_FORGOTTEN = (
    select(func.aggregate_strings(Submission.id + " " + Team.name, "\n"))
    .join(Team, Team.id == Submission.team_id)
    .where(
        Team.id.in_(select(Team.id).where(Team.forgotten_at.is_not(None))),
        exists()
        .where(BoardEntryRow.board_id == BoardRow.id, BoardEntryRow.submission_id == Submission.id)
        .correlate_except(BoardEntryRow),
    )
    .correlate(BoardRow)
)
"""Joins from the few forgotten teams to the board: the reverse reads every entry for each page."""
BoardRow.forgotten = column_property(_FORGOTTEN.scalar_subquery())


class ReportedBoard(Base):
    """An external board, as an organizer imported it beside a phase; its rows are on no board here."""

    __tablename__ = "reported_boards"
    id: Mapped[str] = mapped_column(primary_key=True)
    phase_id: Mapped[str] = mapped_column(ForeignKey("phases.id", ondelete="CASCADE"), index=True)
    title: Mapped[str]
    cite: Mapped[str]
    """Its source: an address or a citation."""
    rows: Mapped[ImportedRows] = mapped_column(DocumentText(ImportedRows))
    imported_at: Mapped[datetime]
    withdrawn_at: Mapped[datetime | None]
    """When it was withdrawn; readers no longer see it."""
