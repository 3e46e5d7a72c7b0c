"""The scoring run: claim the next job, score its upload, record the result in one transaction."""

from functools import lru_cache

import structlog
from sqlalchemy import ColumnElement, Select, bindparam, select, tuple_
from sqlalchemy.orm import Session

from exceptiondrive_records.db.errors import Conflict
from exceptiondrive_records.operations.logs import places
from exceptiondrive_records.phases.scoring_keys import ScoringKey, accepted_under
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.protocols.protocols import find_protocol
from exceptiondrive_records.splits.drawings import find_public_split
from exceptiondrive_records.submissions.questions import entry_replaced_by
from exceptiondrive_records.submissions.sheets import is_scored
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.work.fair_share import waits
from exceptiondrive_records.work.jobs import (
    claim_job,
    finish_failed,
    finish_rejected,
    finish_scored,
)
from exceptiondrive_records.work.tables import Job
from exceptiondrive_schemas.api.own_entries import to_confirm
from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_schemas.split import SplitRef
from exceptiondrive_scoring import SCORER_VERSION
from exceptiondrive_worker.boards.rounding import Rounding
from exceptiondrive_worker.context import WorkerContext
from exceptiondrive_worker.failures import Failure, run_job
from exceptiondrive_worker.splits.faults import SplitRefusedError
from exceptiondrive_worker.splits.floors import FloorsUnreadableError
from exceptiondrive_worker.splits.floors_held import (
    held_floors_are_told,
    hold_floors_again,
    open_split,
)
from exceptiondrive_worker.splits.store import SplitUnavailableError
from exceptiondrive_worker.stages import RejectedUpload, Target

_AWAY: dict[type[Exception], str] = {
    FloorsUnreadableError: "floors unreadable",
    Conflict: "protocol refused",
    SplitUnavailableError: "split unavailable",
}
_CANNOT_LOAD = (ArithmeticError, LookupError, MemoryError, OSError, TypeError, ValueError)
"""Errors of the loader: a split that raises one must not block the jobs of all others."""
_KEY = tuple_(Job.protocol_digest, Job.split_revision)
_SENT = (
    select(
        Submission.file_digest,
        Submission.asks_first,
        Submission.phase_id,
        Phase.split_name,
        Phase.challenge,
    )
    .join(Phase, Phase.id == Submission.phase_id)
    .where(Submission.id == bindparam("submission"))
)

_log = structlog.get_logger("exceptiondrive.worker")


def score_next(context: WorkerContext, lane: Lane, *which: ColumnElement[bool]) -> bool:
    """Score the next job of a lane in fair order; return whether there was one, and may be more.

    A job is skipped while no file holds its registered split revision, or if its protocol was
    altered. While the store or the records are unavailable, all jobs wait. `which` are conditions
    on `Job`.
    """
    with context.database.read() as session:
        waiting = session.execute(_keys_of_waiting(lane, *which))
        wanted = {ScoringKey(digest, revision): name for digest, revision, name in waiting}
        away = [key for key, name in wanted.items() if not _is_here(context, session, name, key)]
    if len(away) == len(wanted):
        return False
    if away:
        which = (*which, _KEY.not_in(away))
    settings = context.settings
    with context.database.write() as session:
        job = claim_job(session, lane, settings.lease_s, settings.max_attempts, *which)
    if job is None:
        return False
    return run_job(
        job.id,
        lambda: _score(context, job),
        lambda failure: _record_failure(context, job, failure),
    )


@lru_cache
def _keys_of_waiting(lane: Lane, *which: ColumnElement[bool]) -> Select[str, str, str]:
    """Select what waiting jobs are scored under: protocol, revision, and the name of the split."""
    return (
        select(Job.protocol_digest, Job.split_revision, Phase.split_name)
        .join(Submission, Submission.id == Job.submission_id)
        .join(Phase, Phase.id == Submission.phase_id)
        .where(waits(lane), *which)
        .distinct()
    )


def _is_here(context: WorkerContext, session: Session, name: str, key: ScoringKey) -> bool:
    ids = {"split": name, "revision": key.split_revision}
    try:
        protocol = find_protocol(session, key.protocol_digest)
        context.splits.floors(name)
        context.splits.find(name, key.split_revision, protocol)
    except tuple(_AWAY) as error:
        what = next(words for kind, words in _AWAY.items() if isinstance(error, kind))
        _log.error(f"{what}: its jobs stay queued", **ids, reason=str(error))
        return False
    except SplitRefusedError as error:
        _log.error("split refused", **ids, reason=str(error))
    except _CANNOT_LOAD as error:  # the log may name its type and place, never its message
        kind = type(error).__qualname__
        _log.error(
            "split cannot be loaded: its jobs stay queued", **ids, error=kind, places=places(error)
        )
        return False
    return True


def _score(context: WorkerContext, job: Job) -> None:
    with context.database.read() as session:
        sent = session.execute(_SENT, {"submission": job.submission_id}).one()
        protocol = find_protocol(session, job.protocol_digest)
        read_under = accepted_under(session, job.submission_id)
        ref = SplitRef(name=sent.split_name, revision=job.split_revision)
        is_public = find_public_split(session, ref) is not None
        is_new = not is_public and not is_scored(session, ref.name, job.submission_id)
    newcomer = job.submission_id if is_new else None
    split = open_split(
        context, ref, protocol, phase_id=sent.phase_id, is_public=is_public, newcomer=newcomer
    )
    target = Target(sent.file_digest, CHALLENGES[sent.challenge], split, protocol, read_under)
    try:
        if sent.asks_first:
            _require_nothing_to_ask(context, target, job.submission_id)
        scored = context.stages.score(target)
    except RejectedUpload as rejected:
        with context.database.write() as session:
            is_recorded = finish_rejected(session, job, rejected.report)
        _log.info("rejected", **_ids(job), is_recorded=is_recorded)
        return
    published = Rounding.of(target, is_public=is_public).sheet(scored.sheet)
    with (
        held_floors_are_told(context.database, ref, protocol, sent.phase_id),
        context.database.write() as session,
    ):
        if not is_public:
            floors = context.splits.floors(ref.name)
            hold_floors_again(session, floors, ref, protocol, newcomer)
        is_recorded = finish_scored(
            session,
            job,
            published,
            exact_digest=scored.digest,
            measurement_key=scored.measurement_key,
            scorer_version=SCORER_VERSION,
        )
    _log.info("scored", **_ids(job), is_recorded=is_recorded)


def _require_nothing_to_ask(context: WorkerContext, target: Target, submission_id: str) -> None:
    """Reject an upload that needs its team's confirmation, if the team wants to be asked.

    The questions follow from the file and the team's own list alone; they reveal nothing of
    regions, controls or scores, for which a team spends a submission.

    Raises:
        RejectedUpload: It replaces an entry, or would not be ranked; the report has the questions.
    """
    report = context.stages.report(target)
    with context.database.read() as session:
        replaced = entry_replaced_by(session, session.get_one(Submission, submission_id))
    asked = tuple(to_confirm(report.unranked_because, replaced).values())
    if report.is_valid and asked:
        raise RejectedUpload(report.model_copy(update={"to_confirm": asked}))


def _record_failure(context: WorkerContext, job: Job, failure: Failure) -> None:
    with context.database.write() as session:
        finish_failed(
            session,
            job,
            failure.code.value,
            failure.message,
            retry=failure.may_retry,
            counts=not failure.is_outage,
            max_attempts=context.settings.max_attempts,
            backoff_s=context.settings.retry_backoff_s,
        )
    _log.warning("scoring failed", **_ids(job), code=failure.code.value)


def _ids(job: Job) -> dict[str, str]:
    """Return the ids that every log line of a job contains."""
    return {"job": job.id, "submission": job.submission_id}
