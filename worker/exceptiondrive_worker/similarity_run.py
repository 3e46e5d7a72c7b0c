"""Compares each scored submission of a phase with earlier ones, for the organizers' report.

Trajectories stay here: only sums over samples are recorded, which depend on no region and no
score.
"""

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import compress

import numpy as np
import structlog
from numpy.typing import NDArray

from exceptiondrive_records.phases.scoring_keys import all_accepted_under
from exceptiondrive_records.submissions.similarity import ScoredFile, keep_alike, scored_files
from exceptiondrive_records.work.fair_share import is_live_job_waiting
from exceptiondrive_schemas.api.similarity import AlikeSubmission
from exceptiondrive_schemas.protocol import ProtocolDocument
from exceptiondrive_scoring.aliases import FloatArray
from exceptiondrive_scoring.similarity import (
    SLACK,
    Alikeness,
    AlikeRule,
    alikeness,
    compare_pair,
    fingerprinted_samples,
    may_be_alike,
)
from exceptiondrive_worker.context import WorkerContext
from exceptiondrive_worker.splits.private_store import Shelf, content_key
from exceptiondrive_worker.stages import RejectedUpload, Target

COMPARED_AT_ONCE = 200
"""Submissions compared after one board; the rest follow after the next one."""
PART_OF_LIMIT = 0.25
"""Comparing stops after this part of the soft time limit of its task, but never before one file."""
POLL_EVERY_S = 0.02
"""How often the run checks whether a live job waits; comparing a file may take part of that."""
NEAREST_KEPT = 10
CANDIDATES = 30
AT_ONCE = 100
Fingerprint = NDArray[np.float32]
Fingerprinted = tuple[ScoredFile, Fingerprint]
Candidate = tuple[ScoredFile, Alikeness]
"""A file, and its similarity to another one by their fingerprints."""

_log = structlog.get_logger("exceptiondrive.worker")


def compare_submissions(context: WorkerContext, phase_id: str, like: Target) -> int:
    """Compare the submissions that were not compared yet; return their number.

    Stops as soon as a live job waits or its time is over; the rest follow with the next board.
    `like` is a target with the challenge, split and protocol of all; its file does not matter.
    """
    rule = like.scoring.alike
    if rule is None:
        return 0
    with context.database.read() as session:
        files = scored_files(session, phase_id)
        accepted = all_accepted_under(session, phase_id)
    fresh = [file for file in files if not file.is_compared][:COMPARED_AT_ONCE]
    if not fresh or _live_job_waits(context):
        return 0
    comparing = _Comparing(context, like, rule, accepted)
    compared: list[Fingerprinted] = [
        (file, fingerprint)
        for file in files
        if file.is_compared and (fingerprint := comparing.fingerprint(file)) is not None
    ]
    found: list[tuple[str, Sequence[AlikeSubmission]]] = []
    try:
        for file in _while_there_is_time(context, fresh):
            alike: Sequence[AlikeSubmission] = []
            if (fingerprint := comparing.fingerprint(file)) is not None:
                alike = comparing.alike(file, fingerprint, compared)
                compared.append((file, fingerprint))
            found.append((file.submission_id, alike))
    finally:  # an interruption ends this after the files that were compared
        with context.database.write() as session:
            for submission_id, alike in found:
                keep_alike(session, submission_id, alike)
    _log.info("submissions compared", phase=phase_id, number=len(found))
    return len(found)


def _while_there_is_time(
    context: WorkerContext, files: Sequence[ScoredFile]
) -> Iterator[ScoredFile]:
    """Yield files until a live job waits or time is over, which is not checked for the first."""
    now = time.monotonic()
    until = now + PART_OF_LIMIT * context.settings.soft_time_limit_s
    poll_at = now
    for number, file in enumerate(files):
        now = time.monotonic()
        if number and now > until:
            return
        if now >= poll_at:
            if _live_job_waits(context):
                return
            poll_at = now + POLL_EVERY_S
        yield file


def _live_job_waits(context: WorkerContext) -> bool:
    with context.database.read() as session:
        return is_live_job_waiting(session)


class _Comparing:
    """Comparisons within one phase."""

    def __init__(
        self,
        context: WorkerContext,
        like: Target,
        rule: AlikeRule,
        accepted: Mapping[str, ProtocolDocument],
    ) -> None:
        self._context, self._like = context, like
        self._rule, self._accepted = rule, accepted
        # withheld, so nobody knows which samples are fingerprinted
        self._seed = content_key("fingerprint", like.split.regions_digest)

    def fingerprint(self, file: ScoredFile) -> Fingerprint | None:
        """Return the compared answers (S, P, C) of a file; None if it cannot be read."""
        private = self._context.private
        key = content_key("fingerprint", file.file_digest, self._like.challenge.id, self._seed)
        kept = private.read_columns(Shelf.FINGERPRINTS, key)
        if kept is not None:
            return kept["ways"]
        ways = self._read_ways(file)
        if ways is None:
            return None
        fingerprint = ways[fingerprinted_samples(len(ways), self._seed)].astype(np.float32)
        private.write_columns(Shelf.FINGERPRINTS, key, {"ways": fingerprint})
        return fingerprint

    def alike(
        self, file: ScoredFile, fingerprint: Fingerprint, compared: Sequence[Fingerprinted]
    ) -> Sequence[AlikeSubmission]:
        """Return the files that it is alike to: the nearest of other teams, and of its own."""
        candidates = self._candidates(file, fingerprint, compared)
        ways = self._read_ways(file) if candidates else None
        if ways is None:
            return []
        own: list[AlikeSubmission] = []
        others: list[AlikeSubmission] = []
        for candidate, _ in candidates:
            other = self._read_ways(candidate)
            if other is None:
                continue
            found, n_different = compare_pair(ways, other, self._rule)
            is_own = candidate.team_id == file.team_id
            if (self._rule.is_probe if is_own else self._rule.is_alike)(found):
                recorded = self._alike_record(candidate, found, n_different, len(ways))
                (own if is_own else others).append(recorded)
        return [*sorted(others, key=_nearest)[:NEAREST_KEPT], *sorted(own, key=_nearest)[:1]]

    def _alike_record(
        self, file: ScoredFile, found: Alikeness, n_different: int, n_samples: int
    ) -> AlikeSubmission:
        is_scaled = not self._rule.is_alike(replace(found, aligned_share=0.0))
        return AlikeSubmission(
            submission_id=file.submission_id,
            equal_share=round(found.equal_share, 4),
            mean_distance=round(found.mean_distance, 2),
            n_different=n_different,
            n_changed=round((1 - found.best_share) * n_samples),
            scale=round(found.scale, 3) if is_scaled else None,
            is_probe=n_different > 0 and self._rule.is_probe(found),
        )

    def _candidates(
        self, file: ScoredFile, fingerprint: Fingerprint, compared: Sequence[Fingerprinted]
    ) -> list[Candidate]:
        own: list[Candidate] = []
        others: list[Candidate] = []
        for start in range(0, len(compared), AT_ONCE):
            files, fingerprints = zip(*compared[start : start + AT_ONCE], strict=True)
            some = np.stack(fingerprints)
            may = may_be_alike(fingerprint, some, self._rule, SLACK)
            found = alikeness(fingerprint, some[may], self._rule)
            for each, by_fingerprint in zip(compress(files, may), found, strict=True):
                is_own = each.team_id == file.team_id
                rule = self._rule.is_probe if is_own else self._rule.is_alike
                if rule(by_fingerprint, SLACK):
                    (own if is_own else others).append((each, by_fingerprint))
        return [
            *sorted(own, key=_likeness_key)[:CANDIDATES],
            *sorted(others, key=_likeness_key)[:CANDIDATES],
        ]

    def _read_ways(self, file: ScoredFile) -> FloatArray | None:
        read_under = self._accepted[file.submission_id]
        target = replace(self._like, file_digest=file.file_digest, read_under=read_under)
        try:
            return self._rule.ways(self._context.stages.answers(target))
        except RejectedUpload:
            _log.warning("not compared: cannot be read any more", submission=file.submission_id)
            return None


def _likeness_key(candidate: Candidate) -> tuple[float, float]:
    _, found = candidate
    return -found.best_share, found.mean_distance


def _nearest(found: AlikeSubmission) -> tuple[int, int, float]:
    return found.n_changed, found.n_different, found.mean_distance
