"""Fan out rescoring runs: create jobs for missing sheets, request draft boards, advance states.

Each pass decides from the records alone, so that it repairs whatever a crash left.
"""

from sqlalchemy import Select, and_, delete, func, select, update
from sqlalchemy.orm import Session

from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.phases.scoring_keys import (
    ScoringKey,
    new_key,
    old_key,
    shadow_key,
)
from exceptiondrive_records.rescoring.progress import (
    count_jobs,
    count_sheets,
    fresh_board,
    jobs_in,
    left_out,
    scored_left_out,
    want_fresh_board,
)
from exceptiondrive_records.rescoring.tables import RescoringRun
from exceptiondrive_records.rescoring.verification import end_verification
from exceptiondrive_records.submissions.submissions import lock_jobs
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.work.jobs import new_job
from exceptiondrive_records.work.tables import OPEN_STATES, WAITING_STATES, Job, WorkState
from exceptiondrive_schemas.api.rescoring import RunKind, RunState
from exceptiondrive_schemas.jobs import Lane

BATCH = 200
"""Maximum number of open jobs of a run per key: a run never floods the queue."""
_ACTOR = "reconciler"
_TENDED = (RunState.SCORING, RunState.PAUSED, RunState.READY, RunState.APPLIED)


def tend_runs(database: Database, max_attempts: int) -> int:
    """Advance every open run by one step; return how many jobs were created.

    Verification of a sheet is given up after `max_attempts`.
    """
    is_tended = RescoringRun.state.in_(_TENDED)
    with database.read() as session:
        if not session.scalar(select(func.count()).where(is_tended)):
            return 0
    with database.write() as session:
        runs = session.scalars(select(RescoringRun).where(is_tended).with_for_update())
        return sum(_tend_run(session, run, max_attempts) for run in runs)


def _tend_run(session: Session, run: RescoringRun, max_attempts: int) -> int:
    if run.kind is RunKind.VERIFICATION:
        end_verification(session, run, max_attempts)
        return 0
    if run.state is RunState.PAUSED:
        hold_jobs(session, run)
        return 0
    _move_jobs(session, run, (WorkState.HELD,), WorkState.QUEUED)  # uploads in a pause were held
    made = 0
    for key in _both_keys(run):
        room = BATCH - count_jobs(session, run.phase_id, key, OPEN_STATES)
        if room > 0:
            made += _make_jobs(session, scored_left_out(run.phase_id, key, room), key)
    if run.state is RunState.APPLIED and not _count_missing(session, run, new_key(run)):
        want_fresh_board(session, run.phase_id, new_key(run))
    key = shadow_key(run)
    if _count_missing(session, run, key):
        return made
    want_fresh_board(session, run.phase_id, key)
    if run.state is RunState.SCORING and fresh_board(session, run.phase_id, key) is not None:
        run.state = RunState.READY
        run.state_at = database_now(session)
        audit(session, _ACTOR, "rescoring ready", run.id, {"phase": run.phase_id})
    return made


def _both_keys(run: RescoringRun) -> tuple[ScoringKey, ...]:
    """Return both keys: the one that is not shown now may be shown again."""
    return new_key(run), old_key(run)


def score_left_out(session: Session, phase_id: str, key: ScoringKey) -> None:
    """Create jobs under the shown key of a phase for submissions that have only jobs of other keys.

    After a run is closed, nothing else creates these jobs, and no board would list the submissions.
    """
    _make_jobs(session, left_out(phase_id, key), key)


def _make_jobs(session: Session, query: Select[Submission], key: ScoringKey) -> int:
    now = database_now(session)
    found = list(session.scalars(query))
    for submission in found:
        session.add(new_job(submission, *key, Lane.RESCORE, False, now))
    return len(found)


def _count_missing(session: Session, run: RescoringRun, key: ScoringKey) -> int:
    return count_sheets(session, run.phase_id, key).missing


def hold_jobs(session: Session, run: RescoringRun) -> None:
    """Hold the waiting jobs of a run; running ones finish."""
    _move_jobs(session, run, (WorkState.QUEUED,), WorkState.HELD)


def release_jobs(session: Session, run: RescoringRun) -> None:
    """Release the held jobs of a run."""
    _move_jobs(session, run, WAITING_STATES, WorkState.QUEUED)


def cancel_jobs(session: Session, run: RescoringRun, key: ScoringKey) -> None:
    """Cancel the jobs of a key that have not started; they can be created again."""
    is_waiting = Job.id.in_(_waiting_jobs(run, key))
    lock_jobs(session, is_waiting)
    session.execute(delete(Job).where(is_waiting).execution_options(synchronize_session=False))


def _move_jobs(
    session: Session, run: RescoringRun, before: tuple[WorkState, ...], after: WorkState
) -> None:
    is_moved = and_(Job.id.in_(_waiting_jobs(run, shadow_key(run))), Job.state.in_(before))
    lock_jobs(session, is_moved)
    session.execute(
        update(Job)
        .where(is_moved)
        .values(state=after, available_at=database_now(session))
        .execution_options(synchronize_session=False)
    )


def _waiting_jobs(run: RescoringRun, key: ScoringKey) -> Select[str]:
    return jobs_in(run.phase_id, key, WAITING_STATES).where(Job.lane == Lane.RESCORE)
