"""Record heartbeats of workers, each with the time until which its worker counts as alive."""

from collections.abc import Sequence

from sqlalchemy import Double, and_, bindparam, delete, select
from sqlalchemy.orm import Session

from exceptiondrive_records.db.clock import NOW, SET_BACK, seconds_from_now
from exceptiondrive_records.db.database import upsert
from exceptiondrive_records.db.last import do_last
from exceptiondrive_records.work.tables import WorkerHeartbeat
from exceptiondrive_schemas.jobs import Lane

HEARTBEAT_TTL_S = 15.0
_SCORER_COUNTS_FOR_S = 3600.0
"""After a newer scorer was killed, older ones may not score for so long."""
MISSED_FOR_S = 120.0
"""A worker without heartbeats is reported as missing for so long; then it counts as gone."""


_LIVES = and_(WorkerHeartbeat.lives_until > NOW, WorkerHeartbeat.at < SET_BACK)
_LIVING = select(WorkerHeartbeat.lanes, WorkerHeartbeat.missing_splits).where(_LIVES)
_COUNTS_SINCE = seconds_from_now(-_SCORER_COUNTS_FOR_S)
_SCORERS = (
    select(WorkerHeartbeat.scorer_version).where(WorkerHeartbeat.at > _COUNTS_SINCE).distinct()
)
_FORGET = delete(WorkerHeartbeat).where(WorkerHeartbeat.at < _COUNTS_SINCE)
_AT = (("at", NOW),)
_MADE = (*_AT, ("lives_until", seconds_from_now(bindparam("ttl_s", type_=Double()))))


def beat(
    session: Session,
    worker_id: str,
    lanes: tuple[Lane, ...] = (Lane.LIVE,),
    scorer_version: str | None = None,
    missing_splits: Sequence[str] = (),
    ttl_s: float = HEARTBEAT_TTL_S,
) -> None:
    """Record a heartbeat, valid for `ttl_s`; delete those over an hour old."""
    values = {
        "worker_id": worker_id,
        "lanes": [lane.value for lane in lanes],
        "scorer_version": scorer_version,
        "missing_splits": list(missing_splits),
        "ttl_s": ttl_s,
    }
    takes = ("lives_until", "lanes", "scorer_version", "missing_splits")
    sign = upsert(session, WorkerHeartbeat, _MADE, _AT, takes=takes, keys=("worker_id",))
    do_last(session, sign, values)
    do_last(session, _FORGET)


def live_workers(
    session: Session, lane: Lane = Lane.LIVE, split: tuple[str, str] | None = None
) -> int:
    """Return how many workers of a lane are alive; each does one item at a time.

    With `split`, a name and a revision, only workers that can use it count.
    """
    names = set() if split is None else {split[0], "@".join(split)}
    found = session.execute(_LIVING)
    return sum(lane.value in lanes and names.isdisjoint(lacks) for lanes, lacks in found)


def missing_splits(session: Session) -> dict[str, bool]:
    """Return the splits, or as `name@revision` the revisions, that some live worker cannot use.

    Each has whether its scoring waits, as no worker of the live lane can use it.
    """
    living = [(lanes, set(lacks)) for lanes, lacks in session.execute(_LIVING)]
    splits = sorted({split for _, lacks in living for split in lacks})
    live = [lacks for lanes, lacks in living if Lane.LIVE.value in lanes]
    return {
        split: not any(lacks.isdisjoint({split, split.partition("@")[0]}) for lacks in live)
        for split in splits
    }


def scorers_at_work(session: Session) -> list[str]:
    """Return the scorer versions of workers with a heartbeat in the last hour, newest last."""
    found = session.scalars(_SCORERS)
    return sorted((version for version in found if version is not None), key=_numbers)


def newer_scorer(session: Session, version: str) -> str | None:
    """Return the newest of `scorers_at_work`, if it is newer than `version`."""
    newest = max(scorers_at_work(session), key=_numbers, default=version)
    return newest if _numbers(newest) > _numbers(version) else None


def _numbers(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in version.split("."))


def forget_worker(session: Session, worker_id: str) -> None:
    """Delete the heartbeat of a worker that shuts down cleanly."""
    session.execute(delete(WorkerHeartbeat).where(WorkerHeartbeat.worker_id == worker_id))
