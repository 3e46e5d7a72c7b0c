"""What of a board or a sheet may be shown now: families and tasks wait for their date."""

from datetime import datetime

from sqlalchemy.orm import Session

from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.phases.policy import families_shown_from, frozen_since
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.submissions.tables import ScoreSheetRow, Submission
from exceptiondrive_schemas.board import Board
from exceptiondrive_schemas.score_sheet import ScoreSheet


def shown_board(phase: Phase, board: Board, now: datetime) -> Board:
    """Return a board as it may be published now; without families before their date."""
    if families_shown_from(phase, now) is None:
        return board
    return board.model_copy(
        update={
            "families": (),
            "entries": tuple(entry.model_copy(update={"families": {}}) for entry in board.entries),
            "comparisons": tuple(
                pair.model_copy(update={"families": {}, "tasks": {}}) for pair in board.comparisons
            ),
        }
    )


def shown_sheet(session: Session, phase: Phase, row: ScoreSheetRow) -> ScoreSheet:
    """Return a sheet as anybody may see it now; without families and tasks before their date."""
    if families_shown_from(phase, database_now(session)) is None:
        return row.sheet
    return without_breakdown(row.sheet)


def without_breakdown(sheet: ScoreSheet) -> ScoreSheet:
    """Return the totals of a sheet alone: nothing that is counted over some samples only.

    A further row with an `n` is counted so too: the answers to samples with one acceptable set tell
    which set each sample has, as a task would.
    """
    extra = {name: row for name, row in sheet.extra.items() if "n" not in row}
    return sheet.model_copy(update={"families": {}, "tasks": {}, "extra": extra})


def score_kept_back_since(
    session: Session, phase: Phase, submission: Submission
) -> datetime | None:
    """Return since when the team is not shown this score; None while it is shown."""
    since = frozen_since(phase, database_now(session))
    if since is None or phase.policy.frozen_scores == "shown" or submission.received_at < since:
        return None
    return since
