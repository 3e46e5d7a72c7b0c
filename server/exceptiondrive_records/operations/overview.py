"""Read model of the overview, what needs an organizer: teams, failures, runs, scoring delays."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import timedelta

from sqlalchemy import Select, exists, func, select
from sqlalchemy.orm import Session

from exceptiondrive_records.audit.log import PROBING_SUSPECTED, SPLIT_FLOOR_HELD
from exceptiondrive_records.audit.tables import AuditLine
from exceptiondrive_records.db.clock import SET_BACK, database_now
from exceptiondrive_records.news.questions import count_waiting
from exceptiondrive_records.operations.troubles import Trouble, troubles
from exceptiondrive_records.phases.phases import list_phases
from exceptiondrive_records.phases.scoring_keys import (
    ScoringKey,
    is_of_key,
    key_of_phase,
    new_key,
)
from exceptiondrive_records.protocols.protocols import find_protocol
from exceptiondrive_records.rescoring.runs import list_runs
from exceptiondrive_records.rescoring.tables import RescoringRun
from exceptiondrive_records.submissions.tables import ScoreSheetRow, Submission
from exceptiondrive_records.teams.tables import Team
from exceptiondrive_records.work.tables import OPEN_STATES, Job, WorkerHeartbeat, WorkState
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.jobs import Lane

NEWEST = 5
SLOW_S = 300.0
"""A new submission that has waited longer than this needs attention."""
_A_DAY = timedelta(days=1)
_A_MONTH = timedelta(days=30)


@dataclass(frozen=True)
class LaneQueue:
    """The queue of one lane; `held` jobs wait for a paused run, and `oldest_s` ignores them."""

    lane: Lane
    waiting: int
    running: int
    held: int
    oldest_s: float | None


@dataclass(frozen=True)
class WorkerSign:
    """The last sign of life of a worker."""

    worker_id: str
    lanes: tuple[str, ...]
    age_s: float
    is_alive: bool


@dataclass(frozen=True)
class Overview:
    """Everything that may need an organizer's attention."""

    pending: tuple[Team, ...]
    n_failed: int
    open_runs: tuple[RescoringRun, ...]
    queue: tuple[LaneQueue, ...]
    workers: tuple[WorkerSign, ...]
    n_received_today: int
    """Submissions received in the last 24 hours."""
    floors_held: tuple[AuditLine, ...]
    """Refused work on withheld splits of the last 30 days that is still requested, newest first."""
    troubles: tuple[Trouble, ...]
    """Problems that raise no error."""
    probing: tuple[AuditLine, ...]
    """Suspicions of probing by workers in the last 30 days, newest first."""
    n_questions: int
    """Unanswered questions of teams."""


def overview(session: Session) -> Overview:
    """Return what needs an organizer now."""
    pending = select(Team).where(Team.pending_since.is_not(None)).order_by(Team.pending_since)
    failed = select(func.count()).where(Submission.status == SubmissionStatus.FAILED)
    open_runs = list_runs(session, only_open=True)
    since = database_now(session) - _A_DAY
    received = select(func.count()).where(Submission.received_at >= since)
    return Overview(
        pending=tuple(session.scalars(pending)),
        n_failed=session.scalar(failed) or 0,
        open_runs=tuple(open_runs),
        queue=tuple(lane_queue(session, lane) for lane in Lane),
        workers=tuple(worker_signs(session)),
        n_received_today=session.scalar(received) or 0,
        floors_held=tuple(_floors_held(session, open_runs)),
        troubles=troubles(session),
        probing=tuple(session.scalars(_of_workers(session, PROBING_SUSPECTED).limit(NEWEST))),
        n_questions=count_waiting(session),
    )


def _of_workers(session: Session, action: str) -> Select[AuditLine]:
    since = database_now(session) - _A_MONTH
    query = select(AuditLine).where(AuditLine.action == action, AuditLine.at >= since)
    return query.order_by(AuditLine.id.desc())


def _floors_held(session: Session, open_runs: Sequence[RescoringRun]) -> list[AuditLine]:
    """Return refusals of work that a phase or an open run still requests.

    Those after which something was scored under the same key are left out.
    """
    phases = list_phases(session, with_hidden=True)
    asked = {(phase.id, *key_of_phase(phase)) for phase in phases}
    asked |= {(run.phase_id, *new_key(run)) for run in open_runs}
    keys = {
        (phase_id, find_protocol(session, digest).version, revision): ScoringKey(digest, revision)
        for phase_id, digest, revision in asked
    }
    found = []
    for line in session.scalars(_of_workers(session, SPLIT_FLOOR_HELD)):
        phase_id = line.detail["phase"]
        key = keys.get((phase_id, line.detail["protocol"], line.detail["revision"]))
        if key is None:
            continue
        scored_since = exists().where(
            is_of_key(ScoreSheetRow, key),
            ScoreSheetRow.created_at > line.at,
            ScoreSheetRow.submission_id == Submission.id,
            Submission.phase_id == phase_id,
        )
        if not session.scalar(select(scored_since)):
            found.append(line)
    return found[:NEWEST]


def lane_queue(session: Session, lane: Lane) -> LaneQueue:
    """Count the jobs of a lane that wait, run, or are held by a paused run."""
    query = (
        select(Job.state, func.count(), func.min(Job.created_at))
        .where(Job.lane == lane, Job.state.in_(OPEN_STATES))
        .group_by(Job.state)
    )
    found = {state: (count, since) for state, count, since in session.execute(query)}
    none = (0, None)
    waiting, oldest = found.get(WorkState.QUEUED, none)
    oldest_s = None
    if oldest is not None:
        oldest_s = max(0.0, (database_now(session) - oldest).total_seconds())
    return LaneQueue(
        lane=lane,
        waiting=waiting,
        running=found.get(WorkState.LEASED, none)[0],
        held=found.get(WorkState.HELD, none)[0],
        oldest_s=oldest_s,
    )


def worker_signs(session: Session) -> Iterable[WorkerSign]:
    """Yield the last heartbeats of workers, newest first; `beat` deletes those over an hour old."""
    now = database_now(session)
    signs = select(WorkerHeartbeat).where(WorkerHeartbeat.at < SET_BACK)
    order = WorkerHeartbeat.at.desc(), WorkerHeartbeat.worker_id
    for row in session.scalars(signs.order_by(*order)):
        age_s = (now - row.at).total_seconds()
        is_alive = row.lives_until > now
        yield WorkerSign(row.worker_id, tuple(row.lanes), age_s, is_alive)
