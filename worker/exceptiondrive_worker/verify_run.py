"""The verification run: recompute a sheet from its upload, and require identical bits.

Cached results are not used: the stages run on an empty private store.
"""

import tempfile
from collections.abc import Sequence
from pathlib import Path

import structlog

from exceptiondrive_records.phases.scoring_keys import accepted_under
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.protocols.protocols import find_protocol
from exceptiondrive_records.rescoring.runs import find_run
from exceptiondrive_records.rescoring.verification import finish_recheck
from exceptiondrive_records.submissions.tables import ScoreSheetRow, Submission
from exceptiondrive_records.work.lease import try_later
from exceptiondrive_records.work.tables import Recheck
from exceptiondrive_schemas.api.rescoring import VerifyState
from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_schemas.score_sheet import ScoreSheet
from exceptiondrive_worker.boards.rounding import Rounding
from exceptiondrive_worker.context import WorkerContext, stages_over
from exceptiondrive_worker.failures import Failure, run_job
from exceptiondrive_worker.splits.private_store import VERIFY_PREFIX, PrivateStore
from exceptiondrive_worker.stages import RejectedUpload, Target

_log = structlog.get_logger("exceptiondrive.worker")


def verify_next(context: WorkerContext) -> bool:
    """Recompute the next sheet; return whether there was one, and may be more."""
    item = context.claim_oldest(Recheck)
    if item is None:
        return False
    return run_job(
        item.id,
        lambda: _verify(context, item),
        lambda failure: _record_failure(context, item, failure),
    )


def _verify(context: WorkerContext, item: Recheck) -> None:
    with context.database.read() as session:
        run = find_run(session, item.run_id)
        submission = session.get_one(Submission, item.submission_id)
        phase = session.get_one(Phase, run.phase_id)
        key = (submission.id, run.to_protocol_digest, run.to_split_revision)
        expected = session.get_one(ScoreSheetRow, key).sheet
        protocol = find_protocol(session, run.to_protocol_digest)
        read_under = accepted_under(session, submission.id)
    challenge = CHALLENGES[phase.challenge]
    # Floors are not checked: they allowed this sheet, and only whether it recurs is reported.
    split = context.splits.find(phase.split_name, run.to_split_revision, protocol)
    target = Target(submission.file_digest, challenge, split, protocol, read_under)
    with tempfile.TemporaryDirectory(prefix=VERIFY_PREFIX, dir=context.private.root) as folder:
        stages = stages_over(context.files, PrivateStore(Path(folder)))
        try:
            scored = stages.score(target)
        except RejectedUpload:
            _record(context, item, VerifyState.DIFFERS, None, "the file is rejected now")
            return
    may_be_published = [  # a split may have become public since
        Rounding.of(target, is_public=each).sheet(scored.sheet) for each in (False, True)
    ]
    note = _difference(item.expected_digest, expected, scored.digest, may_be_published)
    state = VerifyState.EQUAL if note is None else VerifyState.DIFFERS
    _record(context, item, state, scored.digest, note)


def _difference(
    expected_digest: str, expected: ScoreSheet, digest: str, may_be_published: Sequence[ScoreSheet]
) -> str | None:
    """Compare all published numbers and the digest of the unrounded sheet; None if equal."""
    made_by, here = expected.scorer_version, may_be_published[0].scorer_version
    agrees = expected.model_copy(update={"scorer_version": here}) in may_be_published
    if made_by != here:
        numbers = "agree" if agrees else "differ"
        return f"made by scorer {made_by}, recomputed by {here}: the published numbers {numbers}"
    if not agrees:
        return "the published numbers differ"
    if digest != expected_digest:
        return "the published numbers agree, but not the digits that are rounded off"
    return None


def _record(
    context: WorkerContext,
    item: Recheck,
    state: VerifyState,
    found_digest: str | None,
    note: str | None,
) -> None:
    with context.database.write() as session:
        finish_recheck(session, item, state, found_digest, note)
    _log.info("verified", item=item.id, outcome=state.value)


def _record_failure(context: WorkerContext, item: Recheck, failure: Failure) -> None:
    if failure.is_outage:
        wait_s, code = context.settings.retry_backoff_s, failure.code.value
        with context.database.write() as session:
            try_later(session, item, wait_s, counts=False, note=code)
    else:
        _record(context, item, VerifyState.FAILED, None, failure.message)
