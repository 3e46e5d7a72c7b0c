"""The doorbell: calls a worker through the broker. The records are the queue; this only rings.

A ring that fails is logged and forgotten: the reconciler rings again. For a moment after a failure
further rings are skipped, so that a dead broker does not slow every upload down.
"""

import time
from threading import Lock
from typing import Any

import structlog
from celery import Celery
from kombu import Exchange, Queue
from kombu.exceptions import KombuError
from redis.exceptions import RedisError

from exceptiondrive_schemas.jobs import JobName, Lane

# What everyone who speaks to the broker must agree on (docs/decisions/0003-sql-is-the-queue.md).


KEY_PREFIX = "ed:"


def transport_options(*, socket_timeout_s: float = 5.0) -> dict[str, Any]:
    """Return Celery's `broker_transport_options`, the same for doorbell and worker."""
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


_log = structlog.get_logger("exceptiondrive.doorbell")

SOCKET_TIMEOUT_S = 1.0
QUIET_AFTER_FAILURE_S = 2.0


class Doorbell:
    """Rings for one broker. Safe to share between threads, not between forked processes."""

    def __init__(self, broker_url: str) -> None:
        self._app = Celery("exceptiondrive-doorbell", broker=broker_url, set_as_current=False)
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

    def ring_score(self, job_id: str, lane: Lane = Lane.LIVE) -> bool:
        """Call a worker of a lane for a job; return whether the broker took the message."""
        return self._ring(JobName.SCORE, (job_id,), lane)

    def ring_board(
        self,
        phase_id: str,
        protocol_digest: str,
        lane: Lane = Lane.LIVE,
        *,
        split_revision: str | None = None,
    ) -> bool:
        """Call a worker to build a board; return whether the broker took the message."""
        ids = (phase_id, protocol_digest, *((split_revision,) if split_revision else ()))
        return self._ring(JobName.BUILD_BOARD, ids, lane)

    def ring_verification(self, item_id: str) -> bool:
        """Call a worker to recompute a sheet; return whether the broker took the message."""
        return self._ring(JobName.VERIFY, (item_id,), Lane.RESCORE)

    def close(self) -> None:
        """Close all connections."""
        self._app.close()

    def _ring(self, name: JobName, ids: tuple[str, ...], lane: Lane) -> bool:
        if time.monotonic() < self._quiet_until:
            return False
        try:
            self._app.send_task(
                name.value, args=ids, queue=lane.value, ignore_result=True, retry=False
            )
        except (KombuError, RedisError, OSError) as error:
            _log.warning("the broker did not take a ring", job=name.value, error=repr(error))
            with self._lock:
                self._quiet_until = time.monotonic() + QUIET_AFTER_FAILURE_S
            return False
        return True
