"""What the entry and compare pages read from the records."""

from sqlalchemy import select
from sqlalchemy.orm import Session

from exceptiondrive_records.errors import NotFound
from exceptiondrive_records.protocols import find_protocol
from exceptiondrive_records.tables import (
    BoardRow,
    Phase,
    ProtocolRow,
    ScoreSheetRow,
    Submission,
)
from exceptiondrive_schemas.board import Board
from exceptiondrive_schemas.score_sheet import ScoreSheet
from exceptiondrive_schemas.submission import SubmissionStatus
from exceptiondrive_server.pages.board_query import BoardQuery
from exceptiondrive_server.pages.entry_facts import find_entry
from exceptiondrive_server.pages.entry_page import EntryReading, PastSheet, Receipt
from exceptiondrive_server.pages.readings import parsed_board, read_board


def read_entry(session: Session, key: str, query: BoardQuery) -> EntryReading:
    """Read an entry that stands, or stood, on a board.

    Raises:
        NotFound: No board shows it. Submissions that are on no board are their team's alone.
    """
    submission = session.get(Submission, key)
    board, is_current = _board_with(session, key, submission, query)
    entry = find_entry(board, key)
    phase = session.get(Phase, board.phase)
    if entry is None or phase is None:
        raise NotFound("entry", key)
    return EntryReading(
        board=board,
        entry=entry,
        protocol=find_protocol(session, board.protocol.digest),
        phase_title=phase.title,
        is_current=is_current,
        sheet=_sheet(session, key, board) if submission else None,
        receipt=Receipt(submission.file_digest, submission.size_bytes, submission.received_at)
        if submission
        else None,
        past=_past(session, key, board) if submission else (),
    )


def _board_with(
    session: Session, key: str, submission: Submission | None, query: BoardQuery
) -> tuple[Board, bool]:
    """The board asked for, else the current one, else the newest that shows the entry."""
    if submission is None or query.board is not None:
        phase = query.phase or (submission.phase_id if submission else None)
        asked = BoardQuery(phase=phase, board=query.board, protocol=query.protocol)
        reading = read_board(session, asked)
        if reading.board is None:
            raise NotFound("entry", key)
        return reading.board, reading.is_current
    if submission.status == SubmissionStatus.WITHDRAWN:
        raise NotFound("entry", key)
    reading = read_board(session, BoardQuery(phase=submission.phase_id))
    if reading.board and find_entry(reading.board, key):
        return reading.board, True
    newest = (
        select(BoardRow)
        .where(BoardRow.phase_id == submission.phase_id, BoardRow.body.contains(key))
        .order_by(BoardRow.number.desc())
        .limit(1)
    )
    row = session.scalars(newest).first()
    if row is None:
        raise NotFound("entry", key)
    return parsed_board(row), False


def _sheet(session: Session, key: str, board: Board) -> ScoreSheet | None:
    row = session.get(ScoreSheetRow, (key, board.protocol.digest, board.split.revision))
    return row.sheet if row else None


def _past(session: Session, key: str, board: Board) -> tuple[PastSheet, ...]:
    """Score sheets of the same submission on this split, under protocols with a board."""
    published = select(BoardRow.protocol_digest).where(BoardRow.phase_id == board.phase)
    query = (
        select(ScoreSheetRow, ProtocolRow.version)
        .join(ProtocolRow, ProtocolRow.digest == ScoreSheetRow.protocol_digest)
        .where(
            ScoreSheetRow.submission_id == key,
            ScoreSheetRow.split_revision == board.split.revision,
            ScoreSheetRow.protocol_digest.in_(published),
        )
        .order_by(ScoreSheetRow.created_at)
    )
    return tuple(
        PastSheet(version, row.created_at, row.sheet) for row, version in session.execute(query)
    )
