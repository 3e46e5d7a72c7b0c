"""Apply and roll back runs: one transaction moves the pointer, or none if anything is missing."""

from datetime import datetime

from sqlalchemy import Select, func, select, update
from sqlalchemy.orm import Session

from exceptiondrive_records.audit.tables import AuditLine
from exceptiondrive_records.boards.boards import flip_board
from exceptiondrive_records.boards.tables import BoardRow
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.database import Database
from exceptiondrive_records.db.errors import Conflict
from exceptiondrive_records.notifications.inbox import notify_teams
from exceptiondrive_records.phases.allowances import end_own_deadlines
from exceptiondrive_records.phases.phases import lock_phase
from exceptiondrive_records.phases.policy import frozen_since
from exceptiondrive_records.phases.scoring_keys import (
    ScoringKey,
    is_of_key,
    key_of_phase,
    new_key,
    old_key,
    shadow_key,
)
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.rescoring.changes import (
    CURE_OF_FLOORS,
    CURE_OF_SPLIT,
    move_run,
    require_action,
)
from exceptiondrive_records.rescoring.comparison import (
    Compared,
    compare_to_shown,
    what_changed,
)
from exceptiondrive_records.rescoring.fan_out import cancel_jobs
from exceptiondrive_records.rescoring.freeze import (
    end_freeze,
    hold_running_deadlines,
    tell_of_ended_deadlines,
)
from exceptiondrive_records.rescoring.progress import (
    count_sheets,
    failed_sheets,
    fresh_board,
    jobs_in,
)
from exceptiondrive_records.rescoring.reveal import reveal_blockers
from exceptiondrive_records.rescoring.runs import find_run
from exceptiondrive_records.rescoring.tables import RescoringRun
from exceptiondrive_records.rescoring.trials import trial_of
from exceptiondrive_records.submissions.submissions import lock_jobs
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.work.board_requests import want_board
from exceptiondrive_records.work.tables import WAITING_STATES, Job
from exceptiondrive_schemas.api.notifications import NotificationKind
from exceptiondrive_schemas.api.rescoring import Comparison, RunAction, RunState
from exceptiondrive_schemas.api.submission import WAITING
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_schemas.printable import counted

# Failed sheets of a run, with the reasons that workers reported, and advice.


_NAMED = 5
_ENDINGS = ("scoring failed", "submission rejected")
_REJECTED = "file rejected"
_STORE = "Restore the store of uploads, from its backup if need be; then resume the run."
_CURES = {
    "split_refused": CURE_OF_SPLIT,
    "split_floor": "The floors of the withheld split forbid it: the overview and the audit log say "
    "what was asked. Cancel the run, and ask for less.",
    "split_day_full": "The withheld split allows no more within a day: resume the run tomorrow.",
    "time_limit": "Give the workers more time, or reduce the load; then resume the run.",
    "out_of_memory": "Give the workers more memory; then resume the run.",
    "upload_damaged": _STORE,
    "upload_missing": _STORE,
    "upload_unreadable": _STORE,
    _REJECTED: "The files cannot be read under the new protocol or revision, and trying again does not "
    "help: cancel the run.",
}
_USUAL_CURE = "The worker's log names the place in the code; resume the run to try again."


def failed_words(session: Session, run: RescoringRun, key: ScoringKey) -> list[str]:
    """Return a sentence for each reason of failed sheets: how many, whose, and advice."""
    failed = failed_sheets(run.phase_id, key).order_by(Submission.received_at, Submission.id)
    ids = [submission.id for submission in session.scalars(failed)]
    newest = (
        select(func.max(AuditLine.id))
        .where(AuditLine.subject.in_(ids), AuditLine.action.in_(_ENDINGS))
        .group_by(AuditLine.subject)
    )
    lines = session.scalars(select(AuditLine).where(AuditLine.id.in_(newest)))
    codes = {line.subject: line.detail.get("code", _REJECTED) for line in lines}
    by_code: dict[str, list[str]] = {}
    for submission_id in ids:
        by_code.setdefault(codes.get(submission_id, "no answer"), []).append(submission_id)
    return [_failure_sentence(code, found) for code, found in by_code.items()]


def _failure_sentence(code: str, ids: list[str]) -> str:
    more = [f"{len(ids) - _NAMED:,} more"] if len(ids) > _NAMED else []
    named = ", ".join([*ids[:_NAMED], *more])
    cure = _CURES.get(code, _USUAL_CURE)
    return f"{counted(len(ids), 'sheet')} could not be made ({code}): of {named}. {cure}"


_NO_BOARD = (
    "The phase has no board yet that a run could change. If the overview says that the floors of its "
    "withheld split refuse its own protocol, there will be none: cancel the run, and open a new phase "
    "under the new protocol. What failed used no quota."
)
_BLOCKED_IN_WORDS = (RunState.DRAFT, RunState.PAUSED)
"""States that cannot be applied, and for which `blockers_of` has advice of its own."""


def comparison_of(session: Session, run: RescoringRun) -> Compared | None:
    """Return what the next flip of a run would change; None if a board is missing."""
    phase = session.get_one(Phase, run.phase_id)
    return compare_to_shown(session, phase, fresh_board(session, run.phase_id, shadow_key(run)))


def work_out(database: Database, run_id: str) -> None:
    """Compare the boards before a flip, so that its transaction finds the comparison cached.

    It decides nothing: the transaction reads and compares the boards again.
    """
    with database.read() as session:
        run = find_run(session, run_id)
        if not run.state.is_final:
            comparison_of(session, run)


def blockers_of(session: Session, run: RescoringRun) -> tuple[str, ...]:
    """Return a sentence for everything that blocks the next flip."""
    if run.state.is_final:
        return (f"The run has ended: it is {run.state.value.replace('_', ' ')}.",)
    trial = trial_of(session, run.id)
    if run.state is not RunState.APPLIED and trial is not None and trial.state == "refused":
        return (f"{trial.sentence} {CURE_OF_SPLIT}",)
    if run.state is RunState.DRAFT and trial is not None and trial.state == "held":
        return (f"{trial.sentence} {CURE_OF_FLOORS}",)
    if run.state is RunState.DRAFT:
        return ("Scoring has not begun: start it on its page, or by `organizer rescore begin`.",)
    if session.get_one(Phase, run.phase_id).current_board_id is None:
        return (_NO_BOARD,)
    key = shadow_key(run)
    counts = count_sheets(session, run.phase_id, key)
    found = []
    waiting = counts.missing - counts.failed
    if waiting:
        are = "is" if waiting == 1 else "are"
        found.append(f"{counted(waiting, 'sheet')} of {counts.total:,} {are} still missing.")
    if counts.failed:
        found += failed_words(session, run, key)
    if run.state is RunState.PAUSED:
        found.append("The run is paused: resume it.")
    elif not counts.missing and fresh_board(session, run.phase_id, key) is None:
        found.append("The board is being built from the newest sheets; try again in a moment.")
    found += reveal_blockers(session, run)
    return tuple(found)


def obstacles(session: Session, run: RescoringRun, action: RunAction) -> tuple[str, ...]:
    """Return a sentence for everything that blocks a flip, the run's state first."""
    if action is RunAction.ROLLBACK or run.state not in _BLOCKED_IN_WORDS:
        try:
            require_action(session, run, action)
        except Conflict as refusal:
            return (str(refusal),)
    return blockers_of(session, run)


def apply_run(
    session: Session, run_id: str, *, preview: str, reason: str, actor: str
) -> RescoringRun:
    """Show the new board, in one transaction.

    `preview` is the digest of the comparison that the organizer looked at.

    Raises:
        NotFound: No such run.
        Conflict: It is not ready, a sheet is missing or failed, or the preview is stale.
    """
    phase, row, compared = _lock_and_check(session, run_id, RunAction.APPLY)
    _require_seen(compared, preview)
    lost = compared.comparison.no_longer_ranked
    run = move_run(session, run_id, RunAction.APPLY, reason, actor, no_longer_ranked=lost)
    run.applied_at = run.state_at
    run.comparison = compared.comparison
    running = hold_running_deadlines(session, phase)
    if frozen_since(phase, run.state_at) is not None:  # only possible for a reveal
        end_freeze(session, phase, run.state_at, reason=reason, actor=actor)
    run.apply_flip_id = _flip(session, phase, row, new_key(run))
    tell_of_ended_deadlines(session, phase, running)
    notify_of_run(session, run, compared.comparison, "protocol_applied")
    return run


def rollback_run(session: Session, run_id: str, *, reason: str, actor: str) -> RescoringRun:
    """Show the board under the earlier protocol again: the same bytes if nothing was scored since.

    Raises:
        NotFound: No such run.
        Conflict: It is not applied, or sheets of new submissions are missing.
    """
    phase, row, compared = _lock_and_check(session, run_id, RunAction.ROLLBACK)
    lost = compared.comparison.no_longer_ranked
    run = move_run(session, run_id, RunAction.ROLLBACK, reason, actor, no_longer_ranked=lost)
    run.rollback_flip_id = _flip(session, phase, row, old_key(run))
    cancel_jobs(session, run, new_key(run))
    notify_of_run(session, run, compared.comparison, "protocol_rolled_back")
    return run


def notify_of_run(
    session: Session,
    run: RescoringRun,
    comparison: Comparison,
    kind: NotificationKind,
    at: datetime | None = None,
) -> None:
    """Notify the teams whose numbers an update or its rollback changes; `at`: by default now."""
    words = what_changed(session, run, is_taken_back=kind == "protocol_rolled_back")
    notify_teams(session, comparison, kind, run_id=run.id, what_changed=words, at=at)


STALE = (
    "The preview is stale: submissions or boards have changed since, or it is none of this run. Look at "
    "the newest preview, and apply that one."
)


def _require_seen(compared: Compared, preview: str) -> None:
    """Refuse to apply a comparison other than the one that the organizer saw."""
    if compared.digest != preview:
        raise Conflict(STALE)


def _lock_and_check(
    session: Session, run_id: str, action: RunAction
) -> tuple[Phase, BoardRow, Compared]:
    """Lock run and phase, and return the board to show, or refuse with all blockers."""
    run = find_run(session, run_id, lock=True)
    phase = lock_phase(session, run.phase_id)
    in_the_way = obstacles(session, run, action)
    if in_the_way:
        raise Conflict(" ".join(in_the_way))
    expected = new_key(run) if run.state is RunState.APPLIED else old_key(run)
    if key_of_phase(phase) != expected:
        raise Conflict("The phase no longer shows what this run began from; cancel it.")
    row = fresh_board(session, run.phase_id, shadow_key(run))
    compared = compare_to_shown(session, phase, row)
    if row is None or compared is None:
        raise Conflict("The phase has no board yet; try again in a moment.")
    return phase, row, compared


def _flip(session: Session, phase: Phase, row: BoardRow, key: ScoringKey) -> int | None:
    old = key_of_phase(phase)
    phase.protocol_digest, phase.split_revision = key
    phase.late_board_id = None
    if phase.policy.late_entries == "own_view":  # its late view is built next
        want_board(session, phase.id, *key)
    flip = flip_board(session, phase, row)
    _turn_waiting_jobs(session, phase.id, old, key)
    end_own_deadlines(session, phase, database_now(session))
    return None if flip is None else flip.id


def _turn_waiting_jobs(session: Session, phase_id: str, old: ScoringKey, new: ScoringKey) -> None:
    """Make the job under the shown key the first job of submissions without any score yet."""
    waiting = _waiting_under(phase_id, old).intersect(_waiting_under(phase_id, new))
    lock_jobs(session, Job.submission_id.in_(waiting))
    both = list(session.scalars(waiting))  # reread: some may be claimed now
    for key, is_first in ((old, False), (new, True)):
        session.execute(
            update(Job)
            .where(Job.submission_id.in_(both), is_of_key(Job, key))
            .values(is_first=is_first, lane=Lane.LIVE if is_first else Lane.RESCORE)
            .execution_options(synchronize_session=False)
        )


def _waiting_under(phase_id: str, key: ScoringKey) -> Select[str]:
    found = jobs_in(phase_id, key, WAITING_STATES).where(Submission.status.in_(WAITING))
    return found.with_only_columns(Job.submission_id)
