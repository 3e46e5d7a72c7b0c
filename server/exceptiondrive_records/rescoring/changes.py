"""Change states of rescoring runs; each step has an actor, a reason and an audit line."""

from collections.abc import Iterator, Mapping
from typing import Any

from sqlalchemy.orm import Session

from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.database import flush_or_refuse
from exceptiondrive_records.db.errors import Conflict, InvalidRecord
from exceptiondrive_records.db.identifiers import checked_reason, random_id
from exceptiondrive_records.phases.phases import find_phase, lock_phase
from exceptiondrive_records.phases.scoring_keys import (
    ScoringKey,
    is_of_key,
    key_of_phase,
    new_key,
    old_key,
    shadow_key,
)
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.protocols.protocols import find_protocol
from exceptiondrive_records.rescoring.fan_out import (
    cancel_jobs,
    hold_jobs,
    release_jobs,
    score_left_out,
)
from exceptiondrive_records.rescoring.progress import (
    count_sheets,
    failed_sheets,
    progress_of,
)
from exceptiondrive_records.rescoring.runs import find_run, list_runs
from exceptiondrive_records.rescoring.tables import RescoringRun
from exceptiondrive_records.rescoring.trials import ask_for_trial, trial_of
from exceptiondrive_records.rescoring.verification import ask_for_rechecks
from exceptiondrive_records.splits.splits import find_split
from exceptiondrive_records.splits.tables import SplitRow
from exceptiondrive_records.submissions.submissions import find_submission
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.work.jobs import queue_again
from exceptiondrive_records.work.lease import cancel
from exceptiondrive_records.work.tables import Job, Recheck
from exceptiondrive_schemas.api.rescoring import RETRIES, RunAction, RunKind, RunState, next_states
from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_schemas.printable import counted
from exceptiondrive_schemas.protocol import GeometrySection, ProtocolDocument

CURE_OF_SPLIT = (
    "Cancel the run; then change the protocol, or register a revision of the split that moves or "
    "withdraws these samples. Teams can do nothing about it."
)
CURE_OF_FLOORS = (
    "If you start it now, every sheet will fail. Cancel the run and change the protocol, or start it once "
    "the floors allow it."
)
_DONE = {
    RunAction.START: "started",
    RunAction.PAUSE: "paused",
    RunAction.RESUME: "resumed",
    RunAction.APPLY: "applied",
    RunAction.ROLLBACK: "rolled back",
    RunAction.CLOSE: "closed",
    RunAction.CANCEL: "cancelled",
}
"""The word for each action in the audit log, after `rescoring`."""


def create_run(
    session: Session,
    phase_id: str,
    *,
    protocol: str | None = None,
    split_revision: str | None = None,
    reason: str,
    actor: str,
) -> RescoringRun:
    """Draft a run: nothing is scored yet, and only organizers see it.

    Protocol (version or digest) and split revision are the target, by default the present ones.

    Raises:
        NotFound: No such phase, protocol or split revision.
        InvalidRecord: Nothing would change, the reason is empty, or accepted files could not be
            scored under the new protocol or revision.
        Conflict: Another run of the phase is open.
    """
    phase = lock_phase(session, phase_id)
    reason = checked_reason(reason)
    _require_no_open_run(session, phase_id)
    target = _target_key(session, phase, protocol, split_revision)
    run = _new_run(session, RunKind.UPDATE, phase, target, reason, actor)
    detail = {
        "phase": phase.id,
        "reason": reason,
        "protocol": target.protocol_digest,
        "split_revision": target.split_revision,
    }
    audit(session, actor, "rescoring drafted", run.id, detail)
    ask_for_trial(session, run)
    return run


def start_verification(
    session: Session,
    phase_id: str,
    *,
    sample: int | None,
    submission_id: str | None = None,
    reason: str,
    actor: str,
) -> RescoringRun:
    """Start a run that recomputes sheets of a phase from their uploads, and compares every bit.

    It moves no pointer and stores no sheet, so other runs of the phase are independent of it. It
    takes `sample` random sheets, or all if that is None, of the phase or of one submission.

    Raises:
        NotFound: No such phase.
        InvalidRecord: There is no sheet to verify, or the reason is empty.
    """
    phase = find_phase(session, phase_id)
    reason = checked_reason(reason)
    run = _new_run(session, RunKind.VERIFICATION, phase, key_of_phase(phase), reason, actor)
    run.state = RunState.SCORING
    run.started_at = run.resumed_at = run.created_at
    n_sheets = ask_for_rechecks(session, run, sample, submission_id)
    detail = {"phase": phase.id, "reason": reason, "sheets": n_sheets}
    audit(session, actor, "verification started", run.id, detail)
    return run


def verify_submission(
    session: Session, submission_id: str, *, reason: str, actor: str
) -> RescoringRun:
    """Start a verification of one submission's sheet; the audit log has a line for each of both.

    Raises:
        NotFound: No such submission.
        InvalidRecord: It has no sheet under what its phase shows, or the reason is empty.
    """
    phase_id = find_submission(session, submission_id).phase_id
    run = start_verification(
        session, phase_id, sample=None, submission_id=submission_id, reason=reason, actor=actor
    )
    detail = {"verification": run.id, "reason": run.reason}
    audit(session, actor, "sheet recomputed by hand", submission_id, detail)
    return run


def _new_run(
    session: Session, kind: RunKind, phase: Phase, target: ScoringKey, reason: str, actor: str
) -> RescoringRun:
    now = database_now(session)
    run = RescoringRun(
        id=random_id(),
        kind=kind,
        phase_id=phase.id,
        from_protocol_digest=phase.protocol_digest,
        from_split_revision=phase.split_revision,
        to_protocol_digest=target.protocol_digest,
        to_split_revision=target.split_revision,
        state=RunState.DRAFT,
        reason=reason,
        actor=actor,
        created_at=now,
        state_at=now,
    )
    session.add(run)
    flush_or_refuse(session, "The protocol was deleted meanwhile: reload the list.")
    return run


def start_run(session: Session, run_id: str, *, reason: str, actor: str) -> RescoringRun:
    """Start scoring in the background; the reconciler creates the jobs.

    Raises:
        Conflict: It is not a draft, or a worker found that the split cannot be scored under it.
    """
    trial = trial_of(session, run_id)
    if trial is not None and trial.state == "refused":
        raise Conflict(f"{trial.sentence} {CURE_OF_SPLIT}")
    run = move_run(session, run_id, RunAction.START, reason, actor)
    run.started_at = run.resumed_at = run.state_at
    return run


def pause_run(session: Session, run_id: str, *, reason: str, actor: str) -> RescoringRun:
    """Pause a run: no further job of it starts."""
    run = move_run(session, run_id, RunAction.PAUSE, reason, actor)
    hold_jobs(session, run)
    return run


def resume_run(session: Session, run_id: str, *, reason: str, actor: str) -> RescoringRun:
    """Resume a paused run, and retry failed sheets, in any state that has some."""
    run = move_run(session, run_id, RunAction.RESUME, reason, actor)
    run.resumed_at = run.state_at
    release_jobs(session, run)
    key = shadow_key(run)
    failed = failed_sheets(run.phase_id, key).with_only_columns(Submission.id)
    queue_again(session, Job.submission_id.in_(failed), is_of_key(Job, key))
    return run


def cancel_run(session: Session, run_id: str, *, reason: str, actor: str) -> RescoringRun:
    """Cancel a run that was not applied; its finished sheets are kept for reuse."""
    run = move_run(session, run_id, RunAction.CANCEL, reason, actor)
    if run.kind is RunKind.VERIFICATION:
        cancel(session, Recheck, run.state_at, Recheck.run_id == run.id)
    else:
        cancel_jobs(session, run, new_key(run))
    return run


def close_run(session: Session, run_id: str, *, reason: str, actor: str) -> RescoringRun:
    """End an applied run permanently: new submissions are scored under the new protocol only."""
    run = move_run(session, run_id, RunAction.CLOSE, reason, actor)
    cancel_jobs(session, run, old_key(run))
    score_left_out(session, run.phase_id, new_key(run))
    return run


def move_run(
    session: Session,
    run_id: str,
    action: RunAction,
    reason: str,
    actor: str,
    *,
    no_longer_ranked: Mapping[str, str] = {},
) -> RescoringRun:
    """Move a run to another state and write an audit line.

    `no_longer_ranked` has the submissions that lose their rank by this, each with the reason.

    Raises:
        NotFound: No such run.
        InvalidRecord: The reason is empty.
        Conflict: The action is not possible in the present state of the run.
    """
    run = find_run(session, run_id, lock=True)
    reason = checked_reason(reason)
    was = run.state
    run.state = require_action(session, run, action)
    run.state_at = database_now(session)
    if run.state.is_final:
        run.ended_at = run.state_at
        run.ended_with = progress_of(session, run)
    detail: dict[str, Any] = {"phase": run.phase_id, "reason": reason, "was": was.value}
    if no_longer_ranked:
        detail["no_longer_ranked"] = dict(no_longer_ranked)
    audit(session, actor, f"rescoring {_DONE[action]}", run.id, detail)
    return run


def require_action(session: Session, run: RescoringRun, action: RunAction) -> RunState:
    """Return the state to which an action leads.

    Raises:
        Conflict: It is not possible now; the sentence says in which states it is.
    """
    may_retry = action is RunAction.RESUME and run.state in RETRIES
    has_failed = may_retry and count_sheets(session, run.phase_id, shadow_key(run)).failed > 0
    states = next_states(action, has_failed=has_failed, kind=run.kind)
    if run.state in states:
        return states[run.state]
    if not states:
        raise Conflict("The run verifies sheets: it ends by itself, or you cancel it.")
    *first, last = [_state_words(state) for state in states]
    before = f"{', '.join(first)} or {last}" if first else last
    if action is RunAction.RESUME:
        before += ", or has failed sheets"
    done = _DONE[action]
    again = " already" if _state_words(run.state) == done else ""
    raise Conflict(
        f"The run is {_state_words(run.state)}{again}; it can be {done} only while it is {before}."
    )


def _state_words(state: RunState) -> str:
    return "a draft" if state is RunState.DRAFT else state.value.replace("_", " ")


def _require_no_open_run(session: Session, phase_id: str) -> None:
    open_runs = list_runs(session, phase_id, only_open=True)
    if not open_runs:
        return
    run = open_runs[0]
    advice = {RunState.APPLIED: "close it or roll it back", RunState.DRAFT: "begin or cancel it"}
    raise Conflict(
        f"The phase has an open run, {run.id} ({_state_words(run.state)}); "
        f"{advice.get(run.state, 'apply or cancel it')} first."
    )


def _target_key(
    session: Session, phase: Phase, protocol: str | None, split_revision: str | None
) -> ScoringKey:
    digest = phase.protocol_digest if protocol is None else find_protocol(session, protocol).digest
    old = find_split(session, phase.split_name, phase.split_revision)
    new = find_split(session, phase.split_name, split_revision or phase.split_revision)
    target = ScoringKey(digest, new.revision)
    if target == key_of_phase(phase):
        raise InvalidRecord(
            "The phase shows this protocol and split revision already: nothing would change."
        )
    require_readable(
        phase.challenge,
        (find_protocol(session, phase.protocol_digest), old),
        (find_protocol(session, digest), new),
    )
    return target


# Checks whether accepted files of a phase can be scored under the new protocol or revision.
#
# If not, the draft of the run is refused: its sheets would all fail, or use fewer waypoints than
# those of new submissions. Only workers can check that the protocol has all tasks of the split
# (`split_refused`): the server does not know the tasks of a withheld split.


_ADVICE = "Open a new phase for it instead."


def require_readable(
    challenge: str, old: tuple[ProtocolDocument, SplitRow], new: tuple[ProtocolDocument, SplitRow]
) -> None:
    """Refuse a protocol or split revision under which accepted files cannot be scored.

    Raises:
        InvalidRecord: They cannot; all reasons are given.
    """
    reasons = [
        *_sample_reasons(old[1], new[1]),
        *_waypoint_reasons(challenge, old[0].geometry, new[0].geometry),
    ]
    if reasons:
        raise InvalidRecord(" ".join([*reasons, _ADVICE]))


def _sample_reasons(old: SplitRow, new: SplitRow) -> Iterator[str]:
    if new.revision == old.revision:
        return
    before, after = set(old.manifest.sample_ids), set(new.manifest.sample_ids)
    if before - after:
        yield (
            f"The new revision lacks {counted(len(before - after), 'sample')} that accepted files answer: "
            "they could not be read under it."
        )
    if after - before:
        yield (
            f"The new revision has {counted(len(after - before), 'sample')} that no accepted file answers: "
            "they could not be read under it."
        )


def _waypoint_reasons(challenge: str, old: GeometrySection, new: GeometrySection) -> Iterator[str]:
    if not CHALLENGES[challenge].has_waypoints:
        return
    if (old.waypoints, old.time_step_s) != (new.waypoints, new.time_step_s):
        yield (
            f"The protocol asks for {_waypoint_words(new)}; accepted files hold {_waypoint_words(old)}: "
            "they cannot be scored under it."
        )


def _waypoint_words(geometry: GeometrySection) -> str:
    return f"{geometry.waypoints} waypoints {geometry.time_step_s:g} s apart"
