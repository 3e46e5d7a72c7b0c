"""What everyone who speaks to the broker must agree on (research/reliability.md A5)."""

from typing import Any

from kombu import Exchange, Queue

from exceptiondrive_schemas.jobs import Lane

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
