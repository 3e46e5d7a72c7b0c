"""Request boards, and decide when a build may begin: at once if all is scored, else rate-limited.

The cost of a board grows with its entries. While live submissions wait or are being scored, a board
is built two seconds after the first score that it lacks, and at least two seconds, or several times
the duration of the last build, after that build. So boards keep up with readers, whose pages poll
every three seconds, and leave workers free for scoring. The last score of a rush triggers a build
at once.
"""

from datetime import datetime
from functools import cache

from sqlalchemy import ColumnElement, Select, and_, or_, select
from sqlalchemy.orm import Session

from exceptiondrive_records.db.clock import NOW
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.work.fair_share import LIVE_WORK_OPEN
from exceptiondrive_records.work.lease import ask, claim, finish_last, is_free
from exceptiondrive_records.work.tables import OPEN_STATES, BoardRequest
from exceptiondrive_schemas.jobs import Lane

LEAST_PAUSE_S = 2.0
"""Few readers would see boards built in between, which cost as much."""
PAUSE_FACTOR = 4
"""In a rush, builds of a board take at most 1 / (1 + PAUSE_FACTOR) of one worker ..."""
LONGEST_PAUSE_S = 10.0
"""... unless readers would then wait longer than this for the next one."""


def want_board(
    session: Session, phase_id: str, protocol_digest: str, split_revision: str | None = None
) -> None:
    """Request, in this transaction, a new board of the phase under a protocol.

    A draft board, which readers do not see, waits until live work is done. Its entries were scored
    against `split_revision`, by default the one that the phase shows.
    """
    phase = session.get_one(Phase, phase_id)
    shown = (phase.protocol_digest, phase.split_revision)
    key = (protocol_digest, split_revision or phase.split_revision)
    ask(
        session,
        BoardRequest,
        _key(phase_id, *key),
        lane=Lane.LIVE if key == shown else Lane.RESCORE,
        rests_s=LEAST_PAUSE_S,
        phase_id=phase_id,
        protocol_digest=key[0],
        split_revision=key[1],
    )


def is_board_wanted(
    session: Session, phase_id: str, protocol_digest: str, split_revision: str
) -> bool:
    """Whether a board was requested after the last one was built."""
    key = _key(phase_id, protocol_digest, split_revision)
    state = session.scalar(select(BoardRequest.state).where(BoardRequest.key == key))
    return state in OPEN_STATES


def board_begun_at(
    session: Session, phase_id: str, protocol_digest: str, split_revision: str
) -> datetime | None:
    """Return when the last build of a board began; None if there was none."""
    key = _key(phase_id, protocol_digest, split_revision)
    return session.scalar(select(BoardRequest.leased_at).where(BoardRequest.key == key))


def claim_board(session: Session, lane: Lane, lease_s: float) -> BoardRequest | None:
    """Claim the board build of a lane that has been due longest; None if none is due."""
    return claim(session, BoardRequest, _due_longest_first(lane), lease_s)


@cache
def _due_longest_first(lane: Lane) -> Select[str]:
    due = select(BoardRequest.id).where(is_due(lane))
    return due.order_by(BoardRequest.available_at, BoardRequest.id)


def finish_board(session: Session, request: BoardRequest) -> bool:
    """End a build as `finish_last` does: its row is contended, as every score updates it."""
    return finish_last(session, request, pause_after)


def is_due(lane: Lane) -> ColumnElement[bool]:
    """Condition on `BoardRequest`: requested in this lane, not being built, and due."""
    is_rested = or_(BoardRequest.available_at <= NOW, ~LIVE_WORK_OPEN)
    return and_(BoardRequest.lane == lane, is_free(BoardRequest, NOW), is_rested)


def pause_after(build_s: float) -> float:
    """Return how many seconds the next build of a board waits while live work is open."""
    return min(max(PAUSE_FACTOR * build_s, LEAST_PAUSE_S), LONGEST_PAUSE_S)


def _key(phase_id: str, protocol_digest: str, split_revision: str) -> str:
    return f"{phase_id}/{protocol_digest}/{split_revision}"
