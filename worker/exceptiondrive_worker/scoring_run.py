"""The scoring run: claim a job, score its upload, record sheet and status in one step."""

import time
from dataclasses import dataclass

import structlog

from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.protocols.protocols import find_protocol
from exceptiondrive_records.rescoring.keys import accepted_under
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.work.board_rings import ring_boards, ring_due_boards, take_due_boards
from exceptiondrive_records.work.claims import Claim
from exceptiondrive_records.work.jobs import claim, finish_failed, finish_rejected, finish_scored
from exceptiondrive_records.work.ringing import hand_ring_over, ring_due_jobs
from exceptiondrive_records.work.tables import Job
from exceptiondrive_records.work.turns import NextJob, is_live_work_open, next_in_turn
from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_schemas.jobs import Lane
from exceptiondrive_schemas.protocol import Protocol
from exceptiondrive_scoring import SCORER_VERSION
from exceptiondrive_worker.doors import Doors
from exceptiondrive_worker.failures import Failure, job_boundary, places
from exceptiondrive_worker.rounding import Rounding
from exceptiondrive_worker.split_faults import SplitRefusedError
from exceptiondrive_worker.split_store import SplitUnavailableError
from exceptiondrive_worker.stages import RejectedUpload, Target

_MOST_PATIENCE_S = 1.0
"""In a rush of live work a run goes on, at this pace."""
_LOOK_AGAIN_S = 0.02
_MOST_LOOKS = 100
"""Each look but the last found a job that another worker took first, or a missing split."""

_CANNOT_LOAD = (ArithmeticError, LookupError, MemoryError, OSError, TypeError, ValueError)
"""One split that trips the loader must not keep the jobs of all others waiting."""

_log = structlog.get_logger("exceptiondrive.worker")


@dataclass(frozen=True)
class _Wanted:
    """What a job asks for, looked at before it is claimed."""

    job_id: str
    split_name: str
    split_revision: str
    protocol: Protocol
    read_under: Protocol


def answer_ring(doors: Doors, job_id: str) -> None:
    """Come when called: score what is to be scored now, then call for what waits.

    For a live job the ring says "come": the job whose turn it is may be another one by now.
    """
    with doors.database.read() as session:
        job = session.get(Job, job_id)
    if job is None:
        return
    if job.lane is Lane.LIVE:
        score_next(doors)
    else:
        let_live_work_pass(doors)
        score_submission(doors, job_id)
    ring_on(doors, job.lane)


def let_live_work_pass(doors: Doors) -> None:
    """Wait a moment before a job of the background, while other workers have live work.

    All of them write to one database, one after the other. A worker that serves the live lane too
    does not wait: the live work may be waiting for it.
    """
    until = time.monotonic() + (0 if doors.serves_live else _MOST_PATIENCE_S)
    while time.monotonic() < until:
        with doors.database.read() as session:
            if not is_live_work_open(session):
                return
        time.sleep(_LOOK_AGAIN_S)


def ring_on(doors: Doors, lane: Lane = Lane.LIVE) -> None:
    """Call for the boards that are due, and for what waits in a lane."""
    ring_due_boards(doors.database, doors.doorbell, doors.settings)
    ring_due_jobs(doors.database, doors.doorbell, doors.settings, lane, least_room=2)


def score_next(doors: Doors) -> None:
    """Score the live job whose turn it is, if any waits.

    While no file holds the registered split revision of a job, others have their turn.
    """
    without_splits: set[str] = set()
    for _ in range(_MOST_LOOKS):
        with doors.database.read() as session:
            found = next_in_turn(session, doors.settings.max_attempts, without_splits)
        if found is None:
            return
        wanted = _look_at(doors, found.job_id)
        if wanted is None:
            continue
        if not _split_is_there(doors, wanted):
            without_splits.add(wanted.split_revision)
        elif _claim_and_score(doors, wanted, found):
            return


def score_submission(doors: Doors, job_id: str) -> None:
    """Score one submission under one protocol and split revision.

    Does nothing, quietly, when the job is done or another worker has it. While no file holds the
    registered split revision the job is not claimed: it stays queued.
    """
    wanted = _look_at(doors, job_id)
    if wanted is not None and _split_is_there(doors, wanted):
        _claim_and_score(doors, wanted)


def _claim_and_score(doors: Doors, wanted: _Wanted, taken: NextJob | None = None) -> bool:
    """Whether the job could be claimed; it is then scored, or its failure recorded."""
    settings = doors.settings
    with doors.database.write() as session:
        claimed = claim(session, wanted.job_id, settings.lease_s, settings.max_attempts)
        if claimed is not None and taken is not None:
            hand_ring_over(session, taken)
    if claimed is None:
        return False
    with job_boundary(wanted.job_id, lambda failure: _record_failure(doors, claimed, failure)):
        _score(doors, claimed, wanted)
    return True


def _look_at(doors: Doors, job_id: str) -> _Wanted | None:
    with doors.database.read() as session:
        job = session.get(Job, job_id)
        if job is None or job.state.is_final:
            return None
        submission = session.get_one(Submission, job.submission_id)
        phase = session.get_one(Phase, submission.phase_id)
        protocol = find_protocol(session, job.protocol_digest)
        read_under = accepted_under(session, submission.id) or protocol
        return _Wanted(job_id, phase.split_name, job.split_revision, protocol, read_under)


def _split_is_there(doors: Doors, wanted: _Wanted) -> bool:
    try:
        doors.splits.find(wanted.split_name, wanted.split_revision, wanted.protocol)
    except SplitUnavailableError as error:
        _log.error("split unavailable: job stays queued", job=wanted.job_id, reason=str(error))
        return False
    except SplitRefusedError as error:
        _log.error("split refused", job=wanted.job_id, reason=str(error))
    except _CANNOT_LOAD as error:
        _log.error("split cannot be loaded: job stays queued", **_kind(wanted, error))
        return False
    return True


def _kind(wanted: _Wanted, error: Exception) -> dict[str, object]:
    """What the log may say of an error: its kind and place, never its text."""
    return {"job": wanted.job_id, "error": type(error).__qualname__, "places": places(error)}


def _score(doors: Doors, claimed: Claim, wanted: _Wanted) -> None:
    protocol = wanted.protocol
    challenge = CHALLENGES[claimed.challenge]
    split = doors.splits.find(claimed.split_name, claimed.split_revision, protocol)
    try:
        scored = doors.stages.score(
            Target(claimed.file_digest, challenge, split, protocol, wanted.read_under)
        )
    except RejectedUpload as rejected:
        with doors.database.write() as session:
            outcome = finish_rejected(session, claimed, rejected.report)
        _log.info("rejected", **_ids(claimed), outcome=outcome.value)
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
        boards = take_due_boards(session, doors.settings)
    ring_boards(doors.database, doors.doorbell, boards)
    _log.info("scored", **_ids(claimed), outcome=outcome.value)


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
    _log.warning("scoring failed", **_ids(claimed), code=failure.code.value)


def _ids(claimed: Claim) -> dict[str, str]:
    """What every log line of a job names."""
    return {"job": claimed.job_id, "submission": claimed.submission_id}
