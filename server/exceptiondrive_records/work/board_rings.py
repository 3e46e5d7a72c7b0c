"""When a wanted board is rung for: at once while nothing waits, else at a measured pace.

A board costs more, the more entries it has. While live submissions wait, builds of one board pause
for several times what the last one took, so that boards leave the slots to scoring; but no board
lags behind for long, and the last score of a rush is always followed by a build.
"""

from dataclasses import dataclass
from datetime import datetime, timedelta

from sqlalchemy import ColumnElement, or_, select, update
from sqlalchemy.orm import Session

from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.db.settings import RecordsSettings
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.work.doorbell import Doorbell
from exceptiondrive_records.work.tables import BoardRequest
from exceptiondrive_records.work.turns import live_job_waits
from exceptiondrive_schemas.jobs import Lane

PAUSE_FACTOR = 4
"""In a rush the builds of a board take at most 1 / (1 + PAUSE_FACTOR) of one slot ..."""
LONGEST_PAUSE_S = 10.0
"""... unless they take so long that readers would wait longer than this for the next one."""


@dataclass(frozen=True)
class DueBoard:
    """A board for which a worker is to be called, as it was when looked at."""

    phase_id: str
    protocol_digest: str
    split_revision: str
    fence: int
    lane: Lane
    """A board that nobody sees yet, a draft's, waits behind the live ones."""


def build_after(built_at: datetime | None, build_s: float | None) -> datetime | None:
    """Return when the next build may begin while live jobs wait; None: at once."""
    if built_at is None or build_s is None:
        return None
    return built_at + timedelta(seconds=min(PAUSE_FACTOR * max(build_s, 0.0), LONGEST_PAUSE_S))


def due_boards(session: Session, settings: RecordsSettings) -> list[DueBoard]:
    """Return the boards to ring for now: wanted, not being built, not rung, and due."""
    now = database_now(session)
    query = select(BoardRequest).where(
        BoardRequest.wanted > BoardRequest.built,
        or_(BoardRequest.lease_until.is_(None), BoardRequest.lease_until < now),
        or_(
            BoardRequest.rung_at.is_(None),
            BoardRequest.rung_at < now - timedelta(seconds=settings.ring_again_after_s),
        ),
    )
    wanted = list(session.scalars(query))
    if wanted and live_job_waits(session):
        wanted = [row for row in wanted if _is_due(row, now)]
    return [_due(session, row) for row in wanted]


def take_due_boards(session: Session, settings: RecordsSettings) -> list[DueBoard]:
    """Return the boards that are due, marked as rung in this write transaction; ring for them.

    A request that another transaction holds is left to that one, or to the next pass: two that
    wait for each other's would end one of them.
    """
    due = [board for board in due_boards(session, settings) if _is_free(session, board)]
    for board in due:
        _mark(session, board, database_now(session))
    return due


def ring_boards(database: Database, doorbell: Doorbell, taken: list[DueBoard]) -> int:
    """Call workers for boards that were taken; return for how many.

    Those that the broker did not take are due again.
    """
    missed = [board for board in taken if not _ring(doorbell, board)]
    if missed:
        with database.write() as session:
            for board in missed:
                _mark(session, board, None)
    return len(taken) - len(missed)


def ring_due_boards(database: Database, doorbell: Doorbell, settings: RecordsSettings) -> int:
    """Call workers for all boards that are due; return for how many."""
    with database.read() as session:
        if not due_boards(session, settings):
            return 0
    with database.write() as session:
        taken = take_due_boards(session, settings)
    return ring_boards(database, doorbell, taken)


def _due(session: Session, row: BoardRequest) -> DueBoard:
    phase = session.get_one(Phase, row.phase_id)
    key = (row.protocol_digest, row.split_revision)
    is_shown = key == (phase.protocol_digest, phase.split_revision)
    return DueBoard(row.phase_id, *key, row.fence, Lane.LIVE if is_shown else Lane.RESCORE)


def _is_due(row: BoardRequest, now: datetime) -> bool:
    after = build_after(row.built_at, row.build_s)
    return after is None or after <= now


def _ring(doorbell: Doorbell, board: DueBoard) -> bool:
    return doorbell.ring_board(
        board.phase_id, board.protocol_digest, board.lane, split_revision=board.split_revision
    )


def _is_free(session: Session, board: DueBoard) -> bool:
    """Whether its row could be locked at once; on SQLite nobody else writes meanwhile."""
    query = select(BoardRequest.fence).where(*_is(board)).with_for_update(skip_locked=True)
    return session.scalar(query) is not None


def _mark(session: Session, board: DueBoard, rung_at: datetime | None) -> None:
    """Note when a message was sent, unless a worker has claimed the board since."""
    session.execute(
        update(BoardRequest)
        .where(*_is(board))
        .values(rung_at=rung_at)
        .execution_options(synchronize_session=False)
    )


def _is(board: DueBoard) -> tuple[ColumnElement[bool], ...]:
    return (
        BoardRequest.phase_id == board.phase_id,
        BoardRequest.protocol_digest == board.protocol_digest,
        BoardRequest.split_revision == board.split_revision,
        BoardRequest.fence == board.fence,
    )
