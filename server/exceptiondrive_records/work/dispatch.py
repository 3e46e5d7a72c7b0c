"""Wake workers through the broker. The records are the queue; a message only wakes.

A message carries no state and belongs to no item: the worker that takes it claims the next item of
its lane. So messages may be lost or duplicated. An upload sends one if none is waiting in the lane;
a free worker takes it at once, and wakes others for remaining work, at most one message per worker.
A message that the broker refuses is logged and dropped: the reconciler wakes again. For a moment
after a failure none is sent, so that a dead broker does not slow down every upload.
"""

import time
from functools import cache
from threading import Lock
from typing import Any

import structlog
from celery import Celery
from kombu import Exchange, Queue
from kombu.exceptions import KombuError
from redis.exceptions import RedisError
from sqlalchemy import ColumnElement, Select, and_, func, select, update
from sqlalchemy.orm import Session

from exceptiondrive_records.db.clock import NOW, database_now
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.db.settings import RecordsSettings
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.work.board_requests import is_due
from exceptiondrive_records.work.heartbeats import live_workers
from exceptiondrive_records.work.lease import is_claimable
from exceptiondrive_records.work.tables import BoardRequest, Job, Profile, Recheck, Trial, WorkItem
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.jobs import JobName, Lane

_log = structlog.get_logger("exceptiondrive.dispatch")

KEY_PREFIX = "ed:"
SOCKET_TIMEOUT_S = 1.0
QUIET_AFTER_FAILURE_S = 2.0
_KINDS: dict[Lane, tuple[type[WorkItem], ...]] = {
    Lane.LIVE: (BoardRequest, Job, Profile),
    Lane.RESCORE: (BoardRequest, Job, Trial, Recheck),
}
"""The kinds of work in each lane."""


def transport_options(*, socket_timeout_s: float = 5.0) -> dict[str, Any]:
    """Return Celery's `broker_transport_options`, the same for dispatcher and worker."""
    return {
        "visibility_timeout": 300,
        "unacked_restore_interval": 5,
        "unacked_restore_throttle": 1,
        "socket_timeout": socket_timeout_s,
        "socket_connect_timeout": socket_timeout_s,
        "socket_keepalive": True,
        "health_check_interval": 10,
        "retry_on_timeout": True,
        "global_keyprefix": KEY_PREFIX,
        "priority_steps": [0],  # lanes have no priorities: one list to poll, not four
        "max_connections": 20,
    }


def lane_queues() -> tuple[Queue, ...]:
    """Return one queue per lane, each with an exchange of its own.

    Without one, Celery binds all queues to the default exchange under the same key, and every
    message goes to every lane.
    """
    return tuple(
        Queue(lane.value, Exchange(lane.value, type="direct"), routing_key=lane.value)
        for lane in Lane
    )


class Dispatcher:
    """Wakes workers through one broker. Safe to share between threads, not between forked processes."""

    def __init__(self, broker_url: str) -> None:
        self._app = Celery("exceptiondrive-dispatcher", broker=broker_url, set_as_current=False)
        options = transport_options(socket_timeout_s=SOCKET_TIMEOUT_S)
        self._app.conf.update(
            broker_transport_options={**options, "retry_on_timeout": False, "max_retries": 0},
            task_serializer="json",
            task_ignore_result=True,
            task_queues=lane_queues(),
            task_create_missing_queues=False,
            task_default_queue=Lane.LIVE.value,
            broker_connection_timeout=SOCKET_TIMEOUT_S,
            broker_connection_retry=False,
        )
        self._lock = Lock()
        self._quiet_until = 0.0

    def wake(self, lane: Lane, at_most: int = 1) -> bool:
        """Fill a lane up to `at_most` messages; return whether the broker accepted them.

        Concurrent callers may send more, which then wake a worker for nothing.
        """
        if time.monotonic() < self._quiet_until:
            return False
        try:
            with self._app.producer_or_acquire() as producer:
                waiting = producer.channel.queue_declare(queue=lane.value).message_count
                for _ in range(at_most - waiting):
                    self._app.send_task(
                        JobName.WAKE.value,
                        args=(lane.value,),
                        queue=lane.value,
                        ignore_result=True,
                        retry=False,
                        producer=producer,
                    )
        except (KombuError, RedisError, OSError) as error:
            _log.warning("the broker did not take a message", lane=lane.value, error=repr(error))
            with self._lock:
                self._quiet_until = time.monotonic() + QUIET_AFTER_FAILURE_S
            return False
        return True

    def close(self) -> None:
        """Close all connections."""
        self._app.close()


def wake_lanes(database: Database, dispatcher: Dispatcher, settings: RecordsSettings) -> int:
    """Wake workers for due work, at most one message per worker; return the number of items."""
    with database.read() as session:
        due = {
            lane: sum(session.execute(_number_due(lane, settings.max_attempts)).one())
            for lane in Lane
        }
        takers = {lane: max(1, live_workers(session, lane)) for lane in due if due[lane]}
    return sum(
        due[lane] for lane in takers if dispatcher.wake(lane, at_most=min(due[lane], takers[lane]))
    )


def kinds_due(session: Session, lane: Lane, max_attempts: int) -> frozenset[type[WorkItem]]:
    """Return the kinds of work that are due in a lane."""
    found = session.execute(_is_due_by_kind(lane, max_attempts)).one()
    return frozenset(kind for kind, is_any in zip(_KINDS[lane], found, strict=True) if is_any)


def mark_queued(session: Session) -> int:
    """Set received submissions, for which workers were woken, to queued; return how many."""
    found = (
        select(Submission.id)
        .where(Submission.status == SubmissionStatus.RECEIVED)
        .with_for_update(skip_locked=True)
    )
    ids = list(session.scalars(found))
    if ids:
        session.execute(
            update(Submission)
            .where(Submission.id.in_(ids), Submission.status == SubmissionStatus.RECEIVED)
            .values(status=SubmissionStatus.QUEUED, status_at=database_now(session))
            .execution_options(synchronize_session=False)
        )
    return len(ids)


@cache
def _number_due(lane: Lane, max_attempts: int) -> Select[Any]:
    counts = (
        select(func.count(kind.id)).where(_is_item_due(kind, lane, max_attempts))
        for kind in _KINDS[lane]
    )
    return select(*(count.scalar_subquery() for count in counts))


@cache
def _is_due_by_kind(lane: Lane, max_attempts: int) -> Select[Any]:
    due: list[Any] = [
        select(kind.id).where(_is_item_due(kind, lane, max_attempts)).exists()
        for kind in _KINDS[lane]
    ]
    return select(*due)


def _is_item_due(kind: type[WorkItem], lane: Lane, max_attempts: int) -> ColumnElement[bool]:
    if kind is BoardRequest:
        return is_due(lane)
    return and_(kind.lane == lane, kind.attempts < max_attempts, is_claimable(kind, NOW))
