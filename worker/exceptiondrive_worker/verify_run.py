"""The verification run: recompute a sheet from its upload, and demand every bit again.

Nothing that was kept is looked at: the stages run over an empty private store.
"""

import tempfile
from pathlib import Path

import structlog

from exceptiondrive_records.protocols.protocols import find_protocol
from exceptiondrive_records.rescoring.keys import accepted_under
from exceptiondrive_records.rescoring.verification import VerifyClaim, claim_item, finish_item
from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_schemas.rescoring import VerifyState
from exceptiondrive_schemas.score_sheet import ScoreSheet
from exceptiondrive_worker.context import WorkerContext, stages_over
from exceptiondrive_worker.failures import Failure, job_boundary
from exceptiondrive_worker.private_store import VERIFY_PREFIX, PrivateStore
from exceptiondrive_worker.rounding import Rounding
from exceptiondrive_worker.stages import RejectedUpload, Target

_log = structlog.get_logger("exceptiondrive.worker")


def verify_sheet(context: WorkerContext, item_id: str) -> None:
    """Recompute one sheet; does nothing, quietly, when another worker has it."""
    with context.database.write() as session:
        claimed = claim_item(session, item_id, context.settings.lease_s)
    if claimed is None:
        return
    with job_boundary(item_id, lambda failure: _record_failure(context, claimed, failure)):
        _verify(context, claimed)


def _verify(context: WorkerContext, claimed: VerifyClaim) -> None:
    with context.database.read() as session:
        protocol = find_protocol(session, claimed.protocol_digest)
        read_under = accepted_under(session, claimed.submission_id)
    challenge = CHALLENGES[claimed.challenge]
    split = context.splits.find(claimed.split_name, claimed.split_revision, protocol)
    target = Target(claimed.file_digest, challenge, split, protocol, read_under)
    with tempfile.TemporaryDirectory(prefix=VERIFY_PREFIX, dir=context.private.root) as folder:
        stages = stages_over(context.settings, context.files, PrivateStore(Path(folder)))
        try:
            scored = stages.score(target)
        except RejectedUpload:
            _record(context, claimed, VerifyState.DIFFERS, None, "the file is rejected now")
            return
    published = Rounding(challenge, protocol.publication).sheet(scored.sheet)
    state, note = _outcome(claimed, scored.digest, published)
    _record(context, claimed, state, scored.digest, note)


def _outcome(
    claimed: VerifyClaim, digest: str, published: ScoreSheet
) -> tuple[VerifyState, str | None]:
    """Demand the digest of the unrounded sheet, and every published number."""
    if published != claimed.expected_sheet:
        return VerifyState.DIFFERS, "the published numbers differ"
    if digest != claimed.expected_digest:
        return (
            VerifyState.DIFFERS,
            "the published numbers agree, but not the digits that are rounded off",
        )
    return VerifyState.EQUAL, None


def _record(
    context: WorkerContext,
    claimed: VerifyClaim,
    state: VerifyState,
    found_digest: str | None,
    note: str | None,
) -> None:
    with context.database.write() as session:
        finish_item(session, claimed, state, found_digest, note)
    _log.info("verified", item=claimed.item_id, outcome=state.value)


def _record_failure(context: WorkerContext, claimed: VerifyClaim, failure: Failure) -> None:
    _record(context, claimed, VerifyState.FAILED, None, failure.message)
