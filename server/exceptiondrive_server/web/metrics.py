"""Prometheus metrics: requests as they happen, the queue as the records show it at each scrape."""

from collections.abc import Callable, Iterable
from itertools import product
from math import nan

from prometheus_client import CollectorRegistry, Gauge, Histogram, generate_latest
from prometheus_client.metrics_core import GaugeMetricFamily, Metric
from prometheus_client.registry import Collector
from sqlalchemy import case, func, select
from sqlalchemy.orm import Session

from exceptiondrive_records.audit.tables import AuditLine
from exceptiondrive_records.db.clock import SET_BACK, database_now
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.operations.dump import BACKUP, BACKUP_WRITTEN
from exceptiondrive_records.operations.troubles import troubles
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.submissions.views import recent_scoring_s
from exceptiondrive_records.work.heartbeats import MISSED_FOR_S, live_workers
from exceptiondrive_records.work.tables import (
    OPEN_STATES,
    BoardRequest,
    Job,
    WorkerHeartbeat,
    WorkState,
)
from exceptiondrive_schemas.jobs import Lane


class RequestMetrics:
    """Durations of the requests of one application."""

    def __init__(self) -> None:
        self.registry = CollectorRegistry()
        self._seconds = Histogram(
            "exceptiondrive_request_seconds",
            "Duration of requests.",
            ["method", "route", "status"],
            registry=self.registry,
            buckets=(0.005, 0.02, 0.05, 0.1, 0.25, 0.5, 1, 2.5, 10),
        )
        self.ready = Gauge(
            "exceptiondrive_ready", "1: uploads are taken, as /readyz says.", registry=self.registry
        )

    def watch(self, uploads: Callable[[], int], free_bytes: Callable[[], int | None]) -> None:
        """Ask at each scrape how many uploads are under way, and for the room of the store."""
        under_way = Gauge(
            "exceptiondrive_uploads_under_way", "Uploads that come now.", registry=self.registry
        )
        under_way.set_function(uploads)
        free = Gauge(
            "exceptiondrive_store_free_bytes",
            "Room of the file store; NaN where it is no folder.",
            registry=self.registry,
        )
        free.set_function(lambda: nan if (found := free_bytes()) is None else found)

    def observe(self, method: str, route: str, status: int, seconds: float) -> None:
        """Count one request."""
        self._seconds.labels(method, route, str(status)).observe(seconds)


class RecordsCollector(Collector):
    """Reads queue, submissions and workers from the records at each scrape."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def collect(self) -> Iterable[Metric]:
        """Return the gauges."""
        with self._database.read() as session:
            yield from _queue(session)
            yield _submissions(session)
            yield _troubles(session)
            yield from _heartbeats(session)
            yield from _durations(session)
            yield _last_backup(session)


def exposition(requests: RequestMetrics, database: Database) -> bytes:
    """Return all metrics in Prometheus's text format."""
    registry = CollectorRegistry()
    registry.register(RecordsCollector(database))
    return generate_latest(requests.registry) + generate_latest(registry)


def _queue(session: Session) -> Iterable[Metric]:
    depth = GaugeMetricFamily(
        "exceptiondrive_jobs", "Scoring jobs by lane and state.", labels=["lane", "state"]
    )
    oldest = GaugeMetricFamily(
        "exceptiondrive_oldest_queued_seconds", "Age of the oldest waiting job.", labels=["lane"]
    )
    query = select(Job.lane, Job.state, func.count(), func.min(Job.created_at))
    rows = session.execute(query.group_by(Job.lane, Job.state))
    found = {(lane, state): (count, created_at) for lane, state, count, created_at in rows}
    now = database_now(session)
    for lane, state in product(Lane, WorkState):  # each from the beginning: an alert sees the first
        count, created_at = found.get((lane, state), (0, now))
        depth.add_metric([lane, state], count)
        if count and state is WorkState.QUEUED:
            oldest.add_metric([lane], (now - created_at).total_seconds())
    return depth, oldest


def _submissions(session: Session) -> Metric:
    gauge = GaugeMetricFamily(
        "exceptiondrive_submissions", "Submissions by status.", labels=["status"]
    )
    for status, count in session.execute(
        select(Submission.status, func.count()).group_by(Submission.status)
    ):
        gauge.add_metric([status], count)
    return gauge


def _troubles(session: Session) -> Metric:
    gauge = GaugeMetricFamily(
        "exceptiondrive_troubles",
        "What stands wrongly, 1 each: a lane without worker, no reconciler, a split without file; the overview says what to do.",
        labels=["trouble", "subject"],
    )
    for found in troubles(session):
        gauge.add_metric([found.code, found.subject], 1)
    return gauge


def _heartbeats(session: Session) -> Iterable[Metric]:
    gauge = GaugeMetricFamily(
        "exceptiondrive_worker_heartbeat_age_seconds",
        "Since a worker's last sign of life; of those that were alive minutes ago.",
        labels=["worker"],
    )
    alive = GaugeMetricFamily(
        "exceptiondrive_live_workers", "Workers that give signs of life.", labels=["lane"]
    )
    now = database_now(session)
    signs = select(WorkerHeartbeat.worker_id, WorkerHeartbeat.at)
    for worker_id, at in session.execute(signs.where(WorkerHeartbeat.at < SET_BACK)):
        age_s = (now - at).total_seconds()
        if age_s < MISSED_FOR_S:
            gauge.add_metric([worker_id], age_s)
    for lane in Lane:
        alive.add_metric([lane.value], live_workers(session, lane))
    return gauge, alive


def _durations(session: Session) -> Iterable[Metric]:
    scoring = GaugeMetricFamily(
        "exceptiondrive_scoring_seconds", "Median of the last live scoring runs."
    )
    recent_s = recent_scoring_s(session)
    if recent_s is not None:
        scoring.add_metric([], recent_s)
    building = GaugeMetricFamily(
        "exceptiondrive_board_build_seconds", "Longest last build of a board.", labels=["phase"]
    )
    late = GaugeMetricFamily(
        "exceptiondrive_boards_wanted", "Boards that lag behind a score.", labels=["phase"]
    )
    is_wanted = case((BoardRequest.state.in_(OPEN_STATES), 1), else_=0)
    query = select(BoardRequest.phase_id, func.max(BoardRequest.took_s), func.sum(is_wanted))
    for phase, build_s, n_wanted in session.execute(query.group_by(BoardRequest.phase_id)):
        late.add_metric([phase], n_wanted)
        if build_s is not None:
            building.add_metric([phase], build_s)
    return scoring, building, late


def _last_backup(session: Session) -> Metric:
    gauge = GaugeMetricFamily(
        "exceptiondrive_last_backup_timestamp_seconds",
        "When `exceptiondrive-server backup` last wrote a file; 0 for never.",
    )
    written = (AuditLine.subject == BACKUP, AuditLine.action == BACKUP_WRITTEN)
    at = session.scalar(select(func.max(AuditLine.at)).where(*written))
    gauge.add_metric([], 0 if at is None else at.timestamp())
    return gauge
