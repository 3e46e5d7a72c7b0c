"""Reported rows that were imported beside a phase, as the API and pages show them."""

from datetime import datetime

from pydantic import BaseModel
from sqlalchemy.orm import Session

from exceptiondrive_records.boards.reported import measured_on, reported_boards
from exceptiondrive_records.boards.tables import ReportedBoard
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_schemas.reported.imported import ImportedRow, Measured, differences


class ReportedRowView(BaseModel):
    """A row of another board, never ranked here."""

    row: ImportedRow
    differences: tuple[str, ...]
    """What keeps it from being compared with this phase's entries, a sentence each."""


class ReportedBoardView(BaseModel):
    """An external board beside a phase."""

    id: str
    phase: str
    title: str
    cite: str
    imported_at: datetime
    withdrawn_at: datetime | None = None
    rows: tuple[ReportedRowView, ...]


def reported_of(
    session: Session, phase: Phase, *, with_withdrawn: bool = False
) -> list[ReportedBoardView]:
    """Return the external boards that stand beside a phase, the newest first."""
    own = measured_on(session, phase)
    found = reported_boards(session, phase.id, with_withdrawn=with_withdrawn)
    return [reported_view(row, own) for row in found]


def reported_view(row: ReportedBoard, own: Measured) -> ReportedBoardView:
    """Return an external board, each row with what differs from the phase's own."""
    return ReportedBoardView(
        id=row.id,
        phase=row.phase_id,
        title=row.title,
        cite=row.cite,
        imported_at=row.imported_at,
        withdrawn_at=row.withdrawn_at,
        rows=tuple(
            ReportedRowView(row=each, differences=tuple(differences(each, own)))
            for each in row.rows.rows
        ),
    )
