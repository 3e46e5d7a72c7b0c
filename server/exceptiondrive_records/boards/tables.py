"""The tables of boards."""

from datetime import datetime

from sqlalchemy import ForeignKey, Index, Text, UniqueConstraint
from sqlalchemy.orm import Mapped, mapped_column, relationship

from exceptiondrive_records.db.base import Base
from exceptiondrive_records.db.columns import DocumentText
from exceptiondrive_schemas.board import BoardLeader, BoardNews


class BoardRow(Base):
    """A board snapshot, immutable: `body` holds the exact bytes that are served."""

    __tablename__ = "boards"
    __table_args__ = (UniqueConstraint("phase_id", "number"),)
    id: Mapped[int] = mapped_column(primary_key=True)
    phase_id: Mapped[str] = mapped_column(ForeignKey("phases.id", ondelete="CASCADE"))
    protocol_digest: Mapped[str] = mapped_column(ForeignKey("protocols.digest"))
    split_revision: Mapped[str]
    number: Mapped[int]
    digest: Mapped[str]
    """Digest of what the board says (`Board.content_digest`), whatever its number and date."""
    body_digest: Mapped[str]
    """Digest of `body`: the strong ETag."""
    body: Mapped[str] = mapped_column(Text)
    published_at: Mapped[datetime]
    view: Mapped[str] = mapped_column(default="main")
    """`main`, or `late`: the board with late entries among the others."""
    leader: Mapped[BoardLeader | None] = mapped_column(DocumentText(BoardLeader), default=None)
    """Who leads it, for the history: so that no board need be read for that."""
    alias: Mapped["BoardAlias | None"] = relationship(lazy="joined", viewonly=True)

    @property
    def told_body(self) -> str:
        """The bytes that are served: those of the board, until a team on it is forgotten."""
        return self.body if self.alias is None else self.alias.body

    @property
    def told_digest(self) -> str:
        """Digest of `told_body`: the strong ETag."""
        return self.body_digest if self.alias is None else self.alias.body_digest


class BoardAlias(Base):
    """What is told of a board since a team on it was forgotten; `BoardRow.digest` stays its digest."""

    __tablename__ = "board_aliases"
    board_id: Mapped[int] = mapped_column(ForeignKey("boards.id"), primary_key=True)
    body: Mapped[str] = mapped_column(Text)
    body_digest: Mapped[str]


class BoardEntryRow(Base):
    """A submission that stands on a board, written with the board, immutable.

    Rows that the paper reported are no submissions and are not here.
    """

    __tablename__ = "board_entries"
    __table_args__ = (Index("ix_board_entries_submission", "submission_id", "board_id"),)
    board_id: Mapped[int] = mapped_column(ForeignKey("boards.id"), primary_key=True)
    submission_id: Mapped[str] = mapped_column(primary_key=True)
    rank: Mapped[int | None]


class BoardFlip(Base):
    """When the pointer `Phase.current_board_id` moved, append-only."""

    __tablename__ = "board_flips"
    __table_args__ = (Index("ix_board_flips_phase", "phase_id", "at"),)
    id: Mapped[int] = mapped_column(primary_key=True)
    phase_id: Mapped[str] = mapped_column(ForeignKey("phases.id", ondelete="CASCADE"))
    board_id: Mapped[int] = mapped_column(ForeignKey("boards.id", ondelete="CASCADE"))
    at: Mapped[datetime]
    news: Mapped[BoardNews] = mapped_column(DocumentText(BoardNews))
    """Whose scores are others since, for the history: so that no board need be read for that."""
