"""What must hold of every board: a pure function of score sheets under one protocol."""

from collections.abc import Iterator

from pydantic import ValidationError
from sqlalchemy import select
from sqlalchemy.orm import Session

from exceptiondrive_records.tables import BoardEntryRow, BoardRow, Phase, ScoreSheetRow
from exceptiondrive_records.violations import Violation
from exceptiondrive_schemas.base import content_digest
from exceptiondrive_schemas.board import Board, BoardEntry
from exceptiondrive_schemas.score_sheet import MetricRow

_AT_ONCE = 20
"""Boards in memory: a large one takes megabytes."""
_SheetKey = tuple[str, str, str]
_Totals = tuple[MetricRow, MetricRow]
"""Both aggregates of a sheet. Boards repeat their entries, so each is read once."""


def broken_boards(session: Session) -> Iterator[Violation]:
    """Yield what is wrong with boards and with the pointers to them."""
    query = select(BoardRow).order_by(BoardRow.phase_id, BoardRow.number)
    last: dict[str, int] = {}
    totals: dict[_SheetKey, _Totals | None] = {}
    for row in session.scalars(query.execution_options(yield_per=_AT_ONCE)):
        subject = f"{row.phase_id}/{row.number}"
        if row.number != last.get(row.phase_id, 0) + 1:
            yield Violation("board number skipped", subject, "a board is missing before it")
        last[row.phase_id] = row.number
        for rule, text in _faults(session, row, totals):
            yield Violation(rule, subject, text)
    yield from _pointers(session)


def _faults(
    session: Session, row: BoardRow, totals: dict[_SheetKey, _Totals | None]
) -> Iterator[tuple[str, str]]:
    try:
        board = Board.model_validate_json(row.body)
    except ValidationError:
        yield "board unreadable", "its body is not a board"
        return
    if content_digest(board) != row.body_digest or board.content_digest != row.digest:
        yield "board altered", "its bytes do not have the recorded digest"
    if (board.protocol.digest, board.split.revision) != (row.protocol_digest, row.split_revision):
        yield "board of another protocol", "body and row name different ones"
    for entry in board.entries:
        if entry.submission_id is not None:
            key = (entry.submission_id, row.protocol_digest, row.split_revision)
            if key not in totals:
                totals[key] = _totals(session, key)
            yield from _entry_faults(entry, board, totals[key])
    yield from _rank_faults(board)
    kept = select(BoardEntryRow.submission_id, BoardEntryRow.rank)
    rows = {
        (id, rank) for id, rank in session.execute(kept.where(BoardEntryRow.board_id == row.id))
    }
    shown = {(e.submission_id, e.rank) for e in board.entries if e.submission_id is not None}
    if rows != shown:
        yield "entries of a board altered", "the table of entries and the body name different ones"


def _totals(session: Session, key: _SheetKey) -> _Totals | None:
    row = session.get(ScoreSheetRow, key)
    return None if row is None else (row.sheet.micro, row.sheet.macro_family)


def _entry_faults(
    entry: BoardEntry, board: Board, of_sheet: _Totals | None
) -> Iterator[tuple[str, str]]:
    if of_sheet is None:
        yield "entry without a sheet", f"{entry.submission_id} under the board's protocol"
        return
    if (entry.micro, entry.macro_family) != of_sheet:
        yield "entry is not its sheet", str(entry.submission_id)
    if entry.metrics != (entry.micro if board.headline == "micro" else entry.macro_family):
        yield "entry shows another aggregate", str(entry.submission_id)


def _rank_faults(board: Board) -> Iterator[tuple[str, str]]:
    """Ranks are 1, 2, 2, 4: each is one more than the number of entries above it."""
    ranked = [entry.rank for entry in board.entries if entry.rank is not None]
    for entry in board.entries:
        if entry.rank is None:
            continue
        if all(value is None for value in entry.metrics.values()):
            yield "rank without a score", str(entry.submission_id)
        if entry.source != "scored":
            yield "rank of an unscored row", entry.method
        if entry.rank != 1 + sum(other < entry.rank for other in ranked):
            yield "ranks do not follow", f"{entry.submission_id} has rank {entry.rank}"
    if ranked != sorted(ranked):
        yield "ranks do not follow", "entries stand out of order"


def _pointers(session: Session) -> Iterator[Violation]:
    for phase in session.scalars(select(Phase).where(Phase.current_board_id.is_not(None))):
        row = session.get(BoardRow, phase.current_board_id)
        if row is None or row.phase_id != phase.id:
            yield Violation("current board missing", phase.id, "the pointer leads nowhere")
        elif row.protocol_digest != phase.protocol_digest:
            yield Violation("current board of another protocol", phase.id, f"board {row.number}")
