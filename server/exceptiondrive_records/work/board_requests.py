"""Requests for boards, and when a build may begin: at once while nothing waits, else at a pace.

A board costs more, the more entries it has. While live submissions wait, builds of one board pause
for several times what the last one took, so that boards leave the slots to scoring; but no board
lags behind for long, and the last score of a rush is always followed by a build.
"""

from sqlalchemy import ColumnElement, and_, select
from sqlalchemy.orm import Session

from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.work.fair_share import is_live_job_waiting
from exceptiondrive_records.work.lease import ask, claim, finish, is_free
from exceptiondrive_records.work.tables import OPEN_STATES, BoardRequest
from exceptiondrive_schemas.jobs import Lane

PAUSE_FACTOR = 4
"""In a rush the builds of a board take at most 1 / (1 + PAUSE_FACTOR) of one slot ..."""
LONGEST_PAUSE_S = 10.0
"""... unless they take so long that readers would wait longer than this for the next one."""


def want_board(
    session: Session, phase_id: str, protocol_digest: str, split_revision: str | None = None
) -> None:
    """Ask, in this transaction, for a new board of the phase under a protocol.

    A board that nobody sees yet, a draft's, waits behind the live work.

    Args:
        session: Of a write transaction.
        phase_id: Of the phase.
        protocol_digest: Under which its entries are ranked.
        split_revision: Against which they were scored; by default the one the phase shows.
    """
    phase = session.get_one(Phase, phase_id)
    shown = (phase.protocol_digest, phase.split_revision)
    key = (protocol_digest, split_revision or phase.split_revision)
    ask(
        session,
        BoardRequest,
        _key(phase_id, *key),
        lane=Lane.LIVE if key == shown else Lane.RESCORE,
        phase_id=phase_id,
        protocol_digest=key[0],
        split_revision=key[1],
    )


def is_board_wanted(
    session: Session, phase_id: str, protocol_digest: str, split_revision: str | None = None
) -> bool:
    """Whether a newer board is wanted than was built."""
    if split_revision is None:
        split_revision = session.get_one(Phase, phase_id).split_revision
    key = _key(phase_id, protocol_digest, split_revision)
    state = session.scalar(select(BoardRequest.state).where(BoardRequest.key == key))
    return state in OPEN_STATES


def claim_board(
    session: Session, which: ColumnElement[bool], lease_s: float
) -> BoardRequest | None:
    """Lease the build of a board, of several the one that is due longest; None: none is free.

    Args:
        session: Of a write transaction.
        which: Condition on `BoardRequest` (`is_due`).
        lease_s: How long nobody else builds it.
    """
    free = select(BoardRequest.id).where(which, is_free(BoardRequest, database_now(session)))
    order = free.order_by(BoardRequest.available_at, BoardRequest.id)
    return claim(session, BoardRequest, order, lease_s)


def finish_board(session: Session, request: BoardRequest) -> bool:
    """End a build; whether its lease was still held."""
    assert request.leased_at is not None
    build_s = (database_now(session) - request.leased_at).total_seconds()
    return finish(session, request, pause_s=pause_after(build_s))


def is_due(session: Session, lane: Lane) -> ColumnElement[bool]:
    """Condition on `BoardRequest`: wanted in this lane, not being built, and at its pace."""
    now = database_now(session)
    due = and_(BoardRequest.lane == lane, is_free(BoardRequest, now))
    if is_live_job_waiting(session):
        due &= BoardRequest.available_at <= now
    return due


def pause_after(build_s: float) -> float:
    """Return how many seconds the next build of a board waits while live jobs wait too."""
    return min(PAUSE_FACTOR * max(build_s, 0.0), LONGEST_PAUSE_S)


def _key(phase_id: str, protocol_digest: str, split_revision: str) -> str:
    return f"{phase_id}/{protocol_digest}/{split_revision}"
