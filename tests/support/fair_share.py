"""A model of fair share, without a database: what the server's query must agree with."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime

_LONG_AGO = datetime.min.replace(tzinfo=UTC)


@dataclass(frozen=True)
class TeamQueue:
    """What the order depends on, for one team."""

    team_id: int
    n_running: int
    n_waiting: int
    oldest_at: datetime
    """When the oldest of those that wait was accepted."""
    served_at: datetime | None
    """When a worker last took a job of the team."""


def team_to_serve(queues: Sequence[TeamQueue]) -> TeamQueue | None:
    """Return the team whose job is scored next; None when nothing waits."""
    waiting = [queue for queue in queues if queue.n_waiting > 0]
    return min(waiting, key=_order, default=None)


def served(queue: TeamQueue, now: datetime) -> TeamQueue:
    """Return the team's queue after a worker has taken its oldest job."""
    running, waiting = queue.n_running + 1, queue.n_waiting - 1
    return replace(queue, n_running=running, n_waiting=waiting, served_at=now)


def _order(queue: TeamQueue) -> tuple[int, datetime, datetime, int]:
    served_at = queue.served_at or _LONG_AGO
    return (queue.n_running, served_at, queue.oldest_at, queue.team_id)
