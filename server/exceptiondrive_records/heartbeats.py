"""Signs of life: a worker lives while its row is young (research/reliability.md A4)."""

from dataclasses import dataclass
from datetime import timedelta

from sqlalchemy import delete, select
from sqlalchemy.orm import Session

from exceptiondrive_records.clock import database_now
from exceptiondrive_records.tables import WorkerHeartbeat
from exceptiondrive_schemas.jobs import Lane

HEARTBEAT_TTL_S = 15.0
_FORGET_AFTER = timedelta(days=1)


@dataclass(frozen=True)
class LiveWorkers:
    """How many workers live, and how many jobs they take at once."""

    workers: int
    slots: int


def beat(
    session: Session, worker_id: str, lanes: tuple[Lane, ...] = (Lane.LIVE,), slots: int = 1
) -> None:
    """Record a sign of life, every few seconds; forget workers that are long gone."""
    now = database_now(session)
    session.merge(
        WorkerHeartbeat(
            worker_id=worker_id, at=now, lanes=[lane.value for lane in lanes], slots=slots
        )
    )
    session.execute(delete(WorkerHeartbeat).where(WorkerHeartbeat.at < now - _FORGET_AFTER))


def live_workers(
    session: Session, lane: Lane = Lane.LIVE, *, ttl_s: float = HEARTBEAT_TTL_S
) -> LiveWorkers:
    """Return the workers of a lane whose last sign of life is younger than `ttl_s`."""
    oldest = database_now(session) - timedelta(seconds=ttl_s)
    rows = session.scalars(select(WorkerHeartbeat).where(WorkerHeartbeat.at > oldest))
    alive = [row for row in rows if lane.value in row.lanes]
    return LiveWorkers(workers=len(alive), slots=sum(row.slots for row in alive))


def forget_worker(session: Session, worker_id: str) -> None:
    """Take a worker that stops in good order off the list."""
    session.execute(delete(WorkerHeartbeat).where(WorkerHeartbeat.worker_id == worker_id))
