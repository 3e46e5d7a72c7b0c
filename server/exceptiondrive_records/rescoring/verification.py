"""Verification: recompute sheets from the uploads and compare them bit for bit.

It is a rescoring run whose target is its source. Each sheet is an item of the work table, which
records the outcome; no sheet is written.
"""

from collections import Counter

from sqlalchemy import func, select, update
from sqlalchemy.orm import Session

from exceptiondrive_records.audit.log import audit
from exceptiondrive_records.db.clock import database_now
from exceptiondrive_records.db.errors import InvalidRecord, NotFound
from exceptiondrive_records.phases.scoring_keys import is_of_key, new_key
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.protocols.protocols import find_protocol
from exceptiondrive_records.rescoring.runs import find_run, list_runs
from exceptiondrive_records.rescoring.tables import RescoringRun
from exceptiondrive_records.submissions.tables import ScoreSheetRow, Submission
from exceptiondrive_records.work.lease import finish, give_up, new_item
from exceptiondrive_records.work.tables import OPEN_STATES, Recheck, WorkState
from exceptiondrive_schemas.api.rescoring import (
    RunKind,
    RunState,
    VerificationView,
    VerifyItemView,
    VerifyState,
)
from exceptiondrive_schemas.api.submission import SubmissionStatus
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_schemas.score_sheet import ProtocolRef
from exceptiondrive_schemas.split import SplitRef

_UNANSWERED = "recomputing did not finish in any of its attempts"
_NOT_CANCELLED = Recheck.state != WorkState.CANCELLED
"""A sheet of a cancelled verification was neither compared nor failed."""


def ask_for_rechecks(
    session: Session, run: RescoringRun, sample: int | None, submission_id: str | None
) -> int:
    """Request recomputation of sheets, drawn at random by the database; return how many.

    It takes `sample` sheets, or all if that is None, of the phase or of one submission.

    Raises:
        InvalidRecord: There is no sheet.
    """
    query = (
        select(ScoreSheetRow.submission_id, ScoreSheetRow.exact_digest)
        .join(Submission, Submission.id == ScoreSheetRow.submission_id)
        .where(
            Submission.phase_id == run.phase_id,
            Submission.status == SubmissionStatus.SCORED,
            is_of_key(ScoreSheetRow, new_key(run)),
        )
        .order_by(func.random())
        .limit(sample)
    )
    if submission_id is not None:
        query = query.where(ScoreSheetRow.submission_id == submission_id)
    sheets = session.execute(query).all()
    if not sheets:
        what = "The phase has no score sheets" if submission_id is None else "It has no score sheet"
        raise InvalidRecord(f"{what} under the protocol that the phase shows.")
    session.add_all(
        new_item(
            Recheck,
            f"{run.id}/{submission_id}",
            run.created_at,
            lane=Lane.RESCORE,
            run_id=run.id,
            submission_id=submission_id,
            expected_digest=digest,
        )
        for submission_id, digest in sheets
    )
    return len(sheets)


def finish_recheck(
    session: Session,
    item: Recheck,
    state: VerifyState,
    found_digest: str | None,
    note: str | None = None,
) -> bool:
    """Record the outcome of a recomputation; return False if the lease was lost."""
    ended = WorkState.FAILED if state is VerifyState.FAILED else WorkState.DONE
    if not finish(session, item, ended, note=note):
        return False
    session.execute(update(Recheck).where(Recheck.id == item.id).values(found_digest=found_digest))
    if state is not VerifyState.EQUAL:
        _audit_difference(session, item, state, found_digest, note)
    return True


def end_verification(session: Session, run: RescoringRun, max_attempts: int) -> None:
    """Give up sheets without attempts left; close the run once all of its sheets are finished."""
    for item in give_up(session, Recheck, max_attempts, Recheck.run_id == run.id):
        item.note = _UNANSWERED
        _audit_difference(session, item, VerifyState.FAILED, None, _UNANSWERED)
    session.flush()
    counts = _counts(session, run.id)
    if counts[VerifyState.WAITING]:
        return
    run.state = RunState.CLOSED
    run.state_at = run.ended_at = database_now(session)
    outcome = {state.value: count for state, count in counts.items()}
    audit(session, "reconciler", "verification finished", run.id, outcome)


def verification_view(session: Session, run_id: str) -> VerificationView:
    """Return a verification as organizers see it.

    Raises:
        NotFound: There is none.
    """
    run = find_run(session, run_id)
    if run.kind is not RunKind.VERIFICATION:
        raise NotFound("verification", run_id)
    counts = _counts(session, run.id)
    protocol = find_protocol(session, run.to_protocol_digest)
    phase = session.get_one(Phase, run.phase_id)
    bad = select(Recheck).where(
        Recheck.run_id == run.id,
        Recheck.state.not_in(OPEN_STATES),
        Recheck.note.is_not(None),
        _NOT_CANCELLED,
    )
    n_sheets = session.scalars(select(func.count()).where(Recheck.run_id == run.id)).one()
    return VerificationView(
        id=run.id,
        phase=run.phase_id,
        protocol=ProtocolRef.of(protocol),
        split=SplitRef(name=phase.split_name, revision=run.to_split_revision),
        reason=run.reason,
        actor=run.actor,
        created_at=run.created_at,
        finished_at=run.ended_at,
        n_sheets=n_sheets,
        n_equal=counts[VerifyState.EQUAL],
        n_different=counts[VerifyState.DIFFERS],
        n_failed=counts[VerifyState.FAILED],
        problems=tuple(map(_item, session.scalars(bad.order_by(Recheck.submission_id)))),
    )


def rechecks_of(session: Session, submission_id: str) -> tuple[VerifyItemView, ...]:
    """Return every recomputation of the sheets of a submission, newest first."""
    query = (
        select(Recheck)
        .where(Recheck.submission_id == submission_id, _NOT_CANCELLED)
        .order_by(Recheck.created_at.desc(), Recheck.id)
    )
    return tuple(map(_item, session.scalars(query)))


def _item(item: Recheck) -> VerifyItemView:
    return VerifyItemView(
        submission_id=item.submission_id,
        state=_outcome(item.state, has_note=item.note is not None),
        expected_digest=item.expected_digest,
        found_digest=item.found_digest,
        note=item.note,
        asked_at=item.created_at,
        ended_at=item.finished_at,
    )


def list_verifications(
    session: Session, phase_id: str | None = None, limit: int | None = None
) -> list[VerificationView]:
    """Return verifications, newest first, at most `limit`."""
    runs = list_runs(session, phase_id, RunKind.VERIFICATION, limit=limit)
    return [verification_view(session, run.id) for run in runs]


def _outcome(state: WorkState, *, has_note: bool) -> VerifyState:
    """Return the outcome of a work item, whose note says why a sheet was not reproduced."""
    if state in OPEN_STATES:
        return VerifyState.WAITING
    if state is WorkState.DONE:
        return VerifyState.DIFFERS if has_note else VerifyState.EQUAL
    return VerifyState.FAILED


def _counts(session: Session, run_id: str) -> Counter[VerifyState]:
    has_note = Recheck.note.is_not(None)
    query = (
        select(Recheck.state, has_note, func.count())
        .where(Recheck.run_id == run_id, _NOT_CANCELLED)
        .group_by(Recheck.state, has_note)
    )
    counts: Counter[VerifyState] = Counter()
    for state, noted, count in session.execute(query):
        counts[_outcome(state, has_note=bool(noted))] += count
    return counts


def _audit_difference(
    session: Session, item: Recheck, state: VerifyState, found_digest: str | None, note: str | None
) -> None:
    """Write an audit line about a sheet that was not reproduced."""
    detail = {
        "found": found_digest,
        "note": note,
        "verification": item.run_id,
        "expected": item.expected_digest,
    }
    audit(session, "worker", f"sheet {state.value}", item.submission_id, detail)
