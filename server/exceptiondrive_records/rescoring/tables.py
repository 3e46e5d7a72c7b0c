"""The tables of rescoring."""

from datetime import datetime

from sqlalchemy import ForeignKey, Index, Text
from sqlalchemy.orm import Mapped, mapped_column

from exceptiondrive_records.db.base import Base
from exceptiondrive_records.db.columns import DocumentText, enum_text
from exceptiondrive_schemas.api.rescoring import Comparison, Progress, RunKind, RunState


class RescoringRun(Base):
    """One change of the protocol or split revision of a phase, from draft to its end.

    A verification is a run whose target is its source: it compares sheets, and stores none.
    """

    __tablename__ = "rescoring_runs"
    __table_args__ = (Index("ix_rescoring_runs_phase", "phase_id", "state"),)
    id: Mapped[str] = mapped_column(primary_key=True)
    kind: Mapped[RunKind] = mapped_column(enum_text(RunKind))
    phase_id: Mapped[str] = mapped_column(ForeignKey("phases.id"))
    from_protocol_digest: Mapped[str] = mapped_column(ForeignKey("protocols.digest"))
    from_split_revision: Mapped[str]
    to_protocol_digest: Mapped[str] = mapped_column(ForeignKey("protocols.digest"))
    to_split_revision: Mapped[str]
    state: Mapped[RunState] = mapped_column(enum_text(RunState))
    reason: Mapped[str] = mapped_column(Text)
    actor: Mapped[str]
    created_at: Mapped[datetime]
    state_at: Mapped[datetime]
    started_at: Mapped[datetime | None]
    resumed_at: Mapped[datetime | None]
    """When scoring last started or resumed; the rate is measured from then."""
    applied_at: Mapped[datetime | None]
    ended_at: Mapped[datetime | None]
    ended_with: Mapped[Progress | None] = mapped_column(DocumentText(Progress))
    """Progress of an update when it ended; later scores and withdrawals do not change it."""
    apply_flip_id: Mapped[int | None] = mapped_column(ForeignKey("board_flips.id"))
    rollback_flip_id: Mapped[int | None] = mapped_column(ForeignKey("board_flips.id"))
    comparison: Mapped[Comparison | None] = mapped_column(DocumentText(Comparison), deferred=True)
    """The changes that readers saw, stored when the run was applied."""
