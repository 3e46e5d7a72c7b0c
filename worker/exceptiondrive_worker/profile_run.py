"""The profile run: describe the motion in a scored planning file, in the client's own words.

The profile is shown on the page of a submission and by the API; the client prints the same before
upload. No score waits for it.
"""

from __future__ import annotations  # array[float] is not subscriptable at runtime before 3.12

import math
from array import array
from collections.abc import Iterator

import structlog

from exceptiondrive_records.phases.scoring_keys import accepted_under
from exceptiondrive_records.phases.tables import Phase
from exceptiondrive_records.protocols.protocols import find_protocol
from exceptiondrive_records.splits.drawings import find_public_split
from exceptiondrive_records.submissions.tables import Submission
from exceptiondrive_records.work.lease import try_later, wait_before_next_s
from exceptiondrive_records.work.profiles import finish_profile
from exceptiondrive_records.work.tables import Profile
from exceptiondrive_schemas.challenges import CHALLENGES
from exceptiondrive_schemas.check.answers import TrajectoryPair
from exceptiondrive_schemas.check.source_fit import file_profile
from exceptiondrive_schemas.faults import CheckReport
from exceptiondrive_schemas.file_profile import FileProfile, Mend
from exceptiondrive_schemas.protocol import PublicationSection
from exceptiondrive_schemas.split import SplitRef
from exceptiondrive_scoring.aliases import FloatArray
from exceptiondrive_scoring.arrays import TrajectoryPairs
from exceptiondrive_worker.context import WorkerContext
from exceptiondrive_worker.failures import Failure, run_job
from exceptiondrive_worker.splits.floors_held import open_split
from exceptiondrive_worker.stages import Stages, Target

_log = structlog.get_logger("exceptiondrive.worker")


def describe_next(context: WorkerContext) -> bool:
    """Describe the oldest scored file without a profile; return whether there was one."""
    item = context.claim_oldest(Profile)
    if item is None:
        return False
    return run_job(
        item.subject,
        lambda: _describe(context, item),
        lambda failure: _record_failure(context, item, failure),
    )


def _describe(context: WorkerContext, item: Profile) -> None:
    with context.database.read() as session:
        submission = session.get_one(Submission, item.submission_id)
        phase = session.get_one(Phase, submission.phase_id)
        protocol = find_protocol(session, item.protocol_digest)
        read_under = accepted_under(session, submission.id)
        ref = SplitRef(name=phase.split_name, revision=item.split_revision)
        is_public = find_public_split(session, ref) is not None
    split = open_split(context, ref, protocol, phase_id=phase.id, is_public=is_public)
    challenge = CHALLENGES[phase.challenge]
    target = Target(submission.file_digest, challenge, split, protocol, read_under)
    report = sound_report(context.stages, target, submission.size_bytes)
    with context.database.write() as session:
        finish_profile(session, item, report)
    _log.info("described", submission=submission.id)


def _record_failure(context: WorkerContext, item: Profile, failure: Failure) -> None:
    settings, code, counts = context.settings, failure.code.value, not failure.is_outage
    with context.database.write() as session:
        if failure.may_retry and not (counts and item.attempts >= settings.max_attempts):
            wait_s = wait_before_next_s(item, settings.retry_backoff_s)
            try_later(session, item, wait_s, counts=counts, note=code)
        else:
            finish_profile(session, item, None, note=code)


def sound_report(stages: Stages, target: Target, size_bytes: int) -> CheckReport:
    """Return a report without faults that describes the motion in a planning file.

    It uses the file and the public manifest only, never regions or recorded drives that are
    withheld.

    Raises:
        RejectedUpload: The answers are no longer cached, and the upload now has faults.
    """
    manifest, protocol = target.split.manifest, target.protocol
    pairs = TrajectoryPairs.from_columns(stages.answers(target))
    rows = map(TrajectoryPair, _flat_trajectories(pairs.source), _flat_trajectories(pairs.edited))
    profile = file_profile(
        dict(zip(manifest.sample_ids, rows, strict=True)),
        protocol.geometry,
        protocol.plausibility,
        manifest.recorded,
    )
    return CheckReport(
        challenge=target.challenge.id,
        split=manifest.name,
        n_predictions=len(manifest.sample_ids),
        digest=target.file_digest,
        size_bytes=size_bytes,
        profile=None if profile is None else _rounded(profile, protocol.publication),
    )


def _rounded(profile: FileProfile, publication: PublicationSection) -> FileProfile:
    """Round metres and shares to the number of digits that the protocol publishes."""
    mend = profile.mend

    def digits(name: str) -> int:
        is_metres = name.endswith(("_m", "_mps"))
        return publication.metre_decimals if is_metres else publication.percent_decimals + 2

    def of(document: FileProfile | Mend) -> dict[str, float]:
        return {
            name: round(value, digits(name)) for name, value in document if isinstance(value, float)
        }

    mended = None if mend is None else mend.model_copy(update=of(mend))
    return profile.model_copy(update={**of(profile), "mend": mended})


def _flat_trajectories(waypoints_m: FloatArray) -> Iterator[array[float] | None]:
    """Yield each trajectory of (N, T, 2) as a flat array, None where missing."""
    values, width = array("d", waypoints_m.tobytes()), 2 * waypoints_m.shape[1]
    for start in range(0, len(values), width):
        yield None if math.isnan(values[start]) else values[start : start + width]
