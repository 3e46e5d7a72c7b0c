"""The scoring run: claim a job, score its upload, record sheet and status in one step."""

from dataclasses import dataclass

import structlog

from exceptiondrive_records.claims import Claim, Finish
from exceptiondrive_records.jobs import claim, finish_failed, finish_rejected, finish_scored
from exceptiondrive_records.protocols import find_protocol
from exceptiondrive_records.rescoring.reading import accepted_under
from exceptiondrive_records.tables import Job, Phase, Submission
from exceptiondrive_schemas.challenges import CHALLENGES, ChallengeId
from exceptiondrive_schemas.protocol import Protocol
from exceptiondrive_scoring import SCORER_VERSION
from exceptiondrive_worker.doors import Doors
from exceptiondrive_worker.failures import Failure, job_boundary
from exceptiondrive_worker.rounding import Rounding
from exceptiondrive_worker.split_faults import SplitRefusedError
from exceptiondrive_worker.split_store import SplitUnavailableError
from exceptiondrive_worker.stages import RejectedUpload, Target

_log = structlog.get_logger("exceptiondrive.worker")


@dataclass(frozen=True)
class _Wanted:
    """What a job asks for, looked at before it is claimed."""

    split_name: str
    split_revision: str
    protocol: Protocol
    read_under: Protocol


def score_submission(doors: Doors, job_id: str) -> None:
    """Score one submission under one protocol and split revision.

    Does nothing, quietly, when the job is done or another worker has it. While no file holds the
    registered split revision the job is not claimed: it stays queued.
    """
    wanted = _look_at(doors, job_id)
    if wanted is None or not _split_is_there(doors, job_id, wanted):
        return
    with doors.database.write() as session:
        claimed = claim(session, job_id, doors.settings.lease_s, doors.settings.max_attempts)
    if claimed is None:
        return
    with job_boundary(job_id, lambda failure: _record_failure(doors, claimed, failure)):
        _score(doors, claimed, wanted)


def _look_at(doors: Doors, job_id: str) -> _Wanted | None:
    with doors.database.read() as session:
        job = session.get(Job, job_id)
        if job is None or job.state.is_final:
            return None
        submission = session.get_one(Submission, job.submission_id)
        phase = session.get_one(Phase, submission.phase_id)
        protocol = find_protocol(session, job.protocol_digest)
        read_under = accepted_under(session, submission.id) or protocol
        return _Wanted(phase.split_name, job.split_revision, protocol, read_under)


def _split_is_there(doors: Doors, job_id: str, wanted: _Wanted) -> bool:
    try:
        doors.splits.find(wanted.split_name, wanted.split_revision, wanted.protocol)
    except SplitUnavailableError as error:
        _log.error("split unavailable: job stays queued", job=job_id, reason=str(error))
        return False
    except SplitRefusedError as error:
        _log.error("split refused", job=job_id, reason=str(error))
    return True


def _score(doors: Doors, claimed: Claim, wanted: _Wanted) -> None:
    protocol = wanted.protocol
    challenge = CHALLENGES[ChallengeId(claimed.challenge)]
    split = doors.splits.find(claimed.split_name, claimed.split_revision, protocol)
    try:
        scored = doors.stages.score(
            Target(claimed.file_digest, challenge, split, protocol, wanted.read_under)
        )
    except RejectedUpload as rejected:
        with doors.database.write() as session:
            outcome = finish_rejected(session, claimed, rejected.report)
        _log.info("rejected", job=claimed.job_id, outcome=outcome.value)
        return
    published = Rounding(challenge, protocol.publication).sheet(scored.sheet)
    with doors.database.write() as session:
        outcome = finish_scored(
            session,
            claimed,
            published,
            exact_digest=scored.digest,
            measurement_key=scored.measurement_key,
            scorer_version=SCORER_VERSION,
        )
    _log.info("scored", job=claimed.job_id, outcome=outcome.value)
    if outcome is Finish.RECORDED and claimed.is_first:
        doors.doorbell.ring_board(
            claimed.phase_id,
            claimed.protocol_digest,
            claimed.lane,
            split_revision=claimed.split_revision,
        )


def _record_failure(doors: Doors, claimed: Claim, failure: Failure) -> None:
    with doors.database.write() as session:
        finish_failed(
            session,
            claimed,
            failure.code.value,
            failure.message,
            retry=failure.may_retry,
            backoff_s=doors.settings.retry_backoff_s,
        )
